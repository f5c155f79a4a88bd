"""The score against the truth: grasps of many qualities, each lifted several times."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import optimize, stats

from mechsearch.evaluation.episodes import EpisodeRecord
from mechsearch.grasp.learning.metrics import reliability
from mechsearch.processes import Progress, silent
from mechsearch.retrieval.assessment import GraspAssessment, GraspTask, assess_all, shared_network
from mechsearch.types import Array, Floats, MechSearchError


@dataclass(frozen=True, eq=False)
class Calibration:
    """How quality relates to lift success, fitted on half of the heaps, tested on the others.

    Attributes:
        slope: Of the fitted chance of success, `1 / (1 + exp(-(slope logit(quality) + offset)))`.
        offset: Likewise.
        threshold: Quality from which the fitted chance is at least one half.
        brier: Mean squared error of the quality itself on the test half, one execution each.
        brier_fitted: Of the fitted chance.
        rank_correlation: Spearman's, of quality and share of successes, on the test half.
        score_correlation: Spearman's, of graspability and success of the best grasp.
        curve: Mean fitted chance, share of successes and executions (b, 3) on the test half.
        rated: Likewise, of the quality as rated.
        executions: On the test half.
    """

    slope: float
    offset: float
    threshold: float
    brier: float
    brier_fitted: float
    rank_correlation: float
    score_correlation: float
    curve: Floats
    rated: Floats
    executions: int

    def to_json(self) -> dict[str, Any]:
        """Return the calibration as plain lists and numbers."""
        return {**asdict(self), "curve": self.curve.tolist(), "rated": self.rated.tolist()}


def calibrate_network(
    network: Path | None,
    states: Sequence[tuple[str, EpisodeRecord]],
    grasps: int,
    repeats: int,
    workers: int = 1,
    progress: Progress = silent,
) -> Calibration:
    """Lift targets before and after episodes, and hold a network's scores against the success.

    Args:
        network: As in a `GraspTask`.
        states: Episodes, each with its object set as given to `load_object_set`.
        grasps: How many of the best grasps to try, and as many drawn uniformly from all others.
        repeats: Perturbed executions of each.
        workers: Processes; the result does not depend on their number.
        progress: Told after each state.

    Raises:
        MechSearchError: If there is nothing to try, or as `calibrate`.
    """
    if not states or grasps < 1 or repeats < 1:
        raise MechSearchError(
            f"{len(states)} episodes, {grasps} grasps and {repeats} repeats; expected at least one "
            "of each"
        )
    shared_network(network)
    tried: dict[str, Any] = {"at_rest": False, "best": grasps, "drawn": grasps, "repeats": repeats}
    tasks = [
        GraspTask(objects, r.objects, poses, r.target, network, heap_seed=r.heap_seed, **tried)
        for objects, r in states
        for poses in (r.poses[0], r.poses[-1])
    ]
    return calibrate([task.heap_seed for task in tasks], assess_all(tasks, workers, progress))


def calibrate(heaps: Sequence[int], assessments: Sequence[GraspAssessment]) -> Calibration:
    """Fit the chance of success on every second heap, and test it on the others.

    Args:
        heaps: Seed of the heap of each state (S,).
        assessments: Of the states (S,), each grasp executed several times.

    Raises:
        MechSearchError: If a half has no grasp, or all of its executions end alike.
    """
    fitted = set(sorted(set(heaps))[::2])
    pairs = list(zip(heaps, assessments, strict=True))
    learn = _executions([state for heap, state in pairs if heap in fitted])
    test = [state for heap, state in pairs if heap not in fitted]
    quality, won = _executions(test)
    slope, offset = _fitted(*learn)
    chance = _chance(quality, slope, offset)
    threshold = float(1 / (1 + np.exp(offset / slope))) if slope > 0 else float("nan")
    shares = [lift.probability for state in test for lift in state.lifts]
    ranked = stats.spearmanr(np.concatenate([state.quality for state in test]), shares)
    best = [state.lifts[0].probability if state.lifts else 0.0 for state in assessments]
    scored = stats.spearmanr([state.now.score for state in assessments], best)
    return Calibration(
        slope, offset, threshold,
        float(((quality - won) ** 2).mean()), float(((chance - won) ** 2).mean()),
        float(ranked.statistic), float(scored.statistic), reliability(chance, won),
        reliability(quality, won), len(won),
    )  # fmt: skip


def _executions(states: Sequence[GraspAssessment]) -> tuple[Floats, Array]:
    """Return quality (E,) and success (E,) of every perturbed execution."""
    grasps = [pair for state in states for pair in zip(state.quality, state.lifts, strict=True)]
    quality = np.array([q for q, lift in grasps for _ in lift.tried], np.float64)
    won = np.array([k < lift.wins for _, lift in grasps for k in range(len(lift.tried))], np.bool_)
    if not len(won) or won.all() or not won.any():
        raise MechSearchError(
            f"half of the heaps have {len(won)} executions of which {int(won.sum())} succeed; a "
            "calibration needs some of both on either half, so try more heaps"
        )
    return quality, won


def _fitted(quality: Floats, won: Array) -> tuple[float, float]:
    """Return slope and offset of the logistic curve that makes the outcomes likeliest."""
    x = _logit(quality)

    def loss(parameters: Floats) -> float:
        z = parameters[0] * x + parameters[1]
        # The small penalty keeps the curve finite where quality parts the outcomes cleanly.
        return float(np.mean(np.logaddexp(0.0, np.where(won, -z, z))) + 1e-4 * parameters[0] ** 2)

    found = optimize.minimize(loss, np.array([1.0, 0.0]), method="BFGS").x
    return float(found[0]), float(found[1])


def _chance(quality: Floats, slope: float, offset: float) -> Floats:
    chance: Floats = 1 / (1 + np.exp(-(slope * _logit(quality) + offset)))
    return chance


def _logit(quality: Floats) -> Floats:
    q = np.clip(quality, 1e-6, 1 - 1e-6)
    logit: Floats = np.log(q / (1 - q))
    return logit
