"""The score against the truth: grasps of many qualities, each lifted several times."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import optimize, stats

from mechsearch.grasp.learning.metrics import reliability
from mechsearch.grasp.network import GraspNetwork
from mechsearch.grasp.policy import rate
from mechsearch.grasp.quality import BEST
from mechsearch.grasp.retrieval import LiftTask, lift_grasps, on_table
from mechsearch.grasp.standing import at_rest, shared_network
from mechsearch.grasp.view import view_of_heap
from mechsearch.heaps.dataset import object_set
from mechsearch.objects.model import ObjectModel
from mechsearch.processes import map_in_order
from mechsearch.sim.lift import Outcome
from mechsearch.types import Array, Floats, MechSearchError


@dataclass(frozen=True, eq=False)
class TrialTask:
    """One state of a heap whose target shall be grasped.

    Attributes:
        network: File of the grasp network.
        objects: Object set, as given to `load_object_set`.
        names: Of the objects (N,).
        target: Index of the target.
        poses: Of the objects (N, 7).
        heap: Seed of the heap.
        grasps: How many of the best grasps to try, and as many drawn uniformly from all others.
        repeats: Perturbed executions of each.
    """

    network: Path
    objects: str
    names: tuple[str, ...]
    target: int
    poses: Floats
    heap: int
    grasps: int = BEST
    repeats: int = 5


@dataclass(frozen=True, eq=False)
class Trial:
    """What became of the grasps on one state.

    Attributes:
        heap: Seed of the heap.
        score: Graspability of the target; 0 where it is not visible or lost.
        quality: Of each grasp (K,), the best first; none where the score is 0 for want of a target.
        wins: Perturbed executions of each grasp that succeeded (K,).
        repeats: Executions of each grasp.
    """

    heap: int
    score: float
    quality: Floats
    wins: Array
    repeats: int


@dataclass(frozen=True, eq=False)
class Calibration:
    """How quality relates to lift success, fitted on half of the heaps, tested on the others.

    Attributes:
        slope: Of the fitted chance of success, `1 / (1 + exp(-(slope logit(quality) + offset)))`.
        offset: Likewise.
        threshold: Quality from which the fitted chance is at least one half.
        brier: Mean squared error of the quality itself on the test half, one execution each.
        brier_fitted: Of the fitted chance.
        rank_correlation: Spearman's, of quality and share of successes, over grasps of the test
            half.
        score_correlation: Spearman's, of graspability and success of the best grasp, over all
            states.
        curve: Mean fitted chance, share of successes and number of executions (b, 3) on the test
            half.
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


def try_all(tasks: Iterable[TrialTask], workers: int = 1) -> Iterator[Trial]:
    """Yield what became of each state's grasps, in order, whatever the number of workers."""
    yield from map_in_order(_try, tasks, workers)


def try_state(network: GraspNetwork, models: Sequence[ObjectModel], task: TrialTask) -> Trial:
    """Rate the target's grasps, and lift the best and some of the others."""
    poses = at_rest(models, task.poses)
    nothing = Trial(task.heap, 0.0, np.empty(0), np.empty(0, np.intp), task.repeats)
    present, target = on_table(poses, task.target)
    if target is None:
        return nothing
    view = view_of_heap([models[i] for i in present], poses[present], target)
    if not view.mask.any():
        return nothing
    ratings = rate(network, view)
    rng = np.random.default_rng([task.heap, len(present)])
    best = ratings.best(max(BEST, task.grasps))
    chosen = best[: task.grasps] + ratings.drawn(rng, task.grasps)
    grasps = np.stack([grasp.pose(view.camera) for grasp in chosen])
    lift = LiftTask(task.objects, task.names, poses, task.target, grasps, task.repeats)
    lifted = lift_grasps(models, lift)
    wins = [sum(outcome is Outcome.SUCCESS for outcome in result.repeats) for result in lifted]
    score = float(np.mean([grasp.quality for grasp in best[:BEST]]))
    quality = np.array([grasp.quality for grasp in chosen])
    return Trial(task.heap, score, quality, np.array(wins), task.repeats)


def calibrate(trials: Sequence[Trial]) -> Calibration:
    """Fit the chance of success on every second heap, and test it on the others.

    Raises:
        MechSearchError: If a half has no grasp, or all of its executions end alike.
    """
    heaps = sorted({trial.heap for trial in trials})
    fitted = set(heaps[::2])
    learn = _executions([trial for trial in trials if trial.heap in fitted])
    test = [trial for trial in trials if trial.heap not in fitted]
    quality, won = _executions(test)
    slope, offset = _fit(*learn)
    chance = _chance(quality, slope, offset)
    threshold = float(1 / (1 + np.exp(offset / slope))) if slope > 0 else float("nan")
    shares = np.concatenate([trial.wins / trial.repeats for trial in test])
    ranked = stats.spearmanr(np.concatenate([trial.quality for trial in test]), shares)
    best = [trial.wins[0] / trial.repeats if len(trial.wins) else 0.0 for trial in trials]
    scored = stats.spearmanr([trial.score for trial in trials], best)
    return Calibration(
        slope, offset, threshold,
        float(((quality - won) ** 2).mean()), float(((chance - won) ** 2).mean()),
        float(ranked.statistic), float(scored.statistic), reliability(chance, won),
        reliability(quality, won), len(won),
    )  # fmt: skip


def _executions(trials: Sequence[Trial]) -> tuple[Floats, Array]:
    """Return quality (E,) and success (E,) of every perturbed execution."""
    grasps = [(q, w, t.repeats) for t in trials for q, w in zip(t.quality, t.wins, strict=True)]
    quality = np.array([q for q, _, n in grasps for _ in range(n)], np.float64)
    won = np.array([k < w for _, w, n in grasps for k in range(n)], np.bool_)
    if not len(won) or won.all() or not won.any():
        raise MechSearchError(
            f"half of the heaps have {len(won)} executions of which {int(won.sum())} succeed; a "
            "calibration needs some of both on either half, so try more heaps"
        )
    return quality, won


def _fit(quality: Floats, won: Array) -> tuple[float, float]:
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


def _try(task: TrialTask) -> Trial:
    models = object_set(task.objects).models
    return try_state(shared_network(task.network), [models[name] for name in task.names], task)
