"""Scores of recorded episodes, with 95 % confidence intervals over heaps.

The heap is the unit of sampling: every episode counts once, lost targets and failed simulations
included. Means have Student's t intervals; shares of episodes have a Wilson score interval, which
stays inside [0, 1] and does not shrink to a point when all episodes end alike.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from mechsearch.evaluation.episodes import EpisodeRecord
from mechsearch.types import Floats, MechSearchError

METRICS = (
    "reward",
    "visibility_change",
    "uncovered_rate",
    "episode_actions",
    "clutter_moved_m",
    "target_moved_m",
)
"""The scores of an evaluation; each reward term follows them as `term_<name>`."""

GRASP_METRICS = ("graspability_change", "retrieval_before", "retrieval_after")
"""Scores of episodes whose target a grasp network has rated and a gripper has tried to lift."""

SHARES = ("uncovered_rate", "retrieval_before", "retrieval_after")
"""Scores that are 1 or 0 in one episode."""

_LOWER_IS_BETTER = ("episode_actions", "clutter_moved_m", "target_moved_m")
HIGHER_IS_BETTER = {name: name not in _LOWER_IS_BETTER for name in (*METRICS, *GRASP_METRICS)}

RETRIEVED = "success"
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Estimate:
    """A mean over heaps and its confidence interval; the interval is NaN for a single heap."""

    mean: float
    ci_low: float
    ci_high: float
    heaps: int


def measure(record: EpisodeRecord) -> dict[str, float]:
    """Return the metrics of one episode.

    Returns:
        `reward` (sum over the episode), `visibility_change` (start minus end occlusion),
        `uncovered_rate` (1 or 0), `episode_actions` (the limit unless uncovered),
        `clutter_moved_m` (path length of a non-target object, averaged over them) [m],
        `target_moved_m` (path length of the target) [m], `term_<name>` for each reward term, and
        where it was measured `graspability_change` (end minus start) and `retrieval_before` and
        `retrieval_after` (1 if the best grasp lifts the target, else 0).

    Raises:
        MechSearchError: If a value is not finite, since it could not stay in a mean.
    """
    values = {
        "reward": record.rewards.sum(),
        "visibility_change": record.occlusions[0] - record.occlusions[-1],
        "uncovered_rate": record.uncovered,
        "episode_actions": len(record.actions) if record.uncovered else record.action_limit,
        "clutter_moved_m": record.clutter_moved.sum(),
        "target_moved_m": record.target_moved.sum(),
    }
    values |= {f"term_{name}": term.sum() for name, term in record.reward_terms.items()}
    grasp = record.grasp
    if grasp is not None:
        values["graspability_change"] = grasp.after - grasp.before
        values["retrieval_before"] = grasp.lift_before == RETRIEVED
        values["retrieval_after"] = grasp.lift_after == RETRIEVED
    for name, value in values.items():
        if not np.isfinite(value):
            raise MechSearchError(
                f"{name} of {record.policy} on heap {record.heap_seed} is {value}; "
                "expected a finite number"
            )
    return {name: float(value) for name, value in values.items()}


def mean_interval(values: ArrayLike) -> Estimate:
    """Return the mean of values (n,) with Student's t interval."""
    x = _checked(values)
    mean, n = float(x.mean()), len(x)
    if n == 1:
        return Estimate(mean, float("nan"), float("nan"), 1)
    half = float(stats.t.ppf((1 + CONFIDENCE) / 2, n - 1) * x.std(ddof=1) / np.sqrt(n))
    return Estimate(mean, mean - half, mean + half, n)


def share_interval(outcomes: ArrayLike) -> Estimate:
    """Return the share of outcomes (n,), each 0 or 1, with Wilson's score interval."""
    x = _checked(outcomes)
    share, n = float(x.mean()), len(x)
    z = float(stats.norm.ppf((1 + CONFIDENCE) / 2))
    centre = (share + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z * np.sqrt(share * (1 - share) / n + (z / (2 * n)) ** 2) / (1 + z**2 / n)
    # Rounding may put an end past the share itself where all outcomes are alike.
    low, high = min(share, float(centre - half)), max(share, float(centre + half))
    return Estimate(share, max(0.0, low), min(1.0, high), n)


def score(records: Iterable[EpisodeRecord]) -> dict[str, Estimate]:
    """Return every metric over all the episodes.

    Raises:
        MechSearchError: If there are none, or grasps were tried in only some of them.
    """
    measured = [measure(record) for record in records]
    if not measured:
        raise MechSearchError("there is no episode to score; expected at least one")
    grasped = sum("graspability_change" in values for values in measured)
    if 0 < grasped < len(measured):
        raise MechSearchError(
            f"grasps were tried in {grasped} of {len(measured)} episodes; expected all or none"
        )
    return {
        name: (share_interval if name in SHARES else mean_interval)(
            [values[name] for values in measured]
        )
        for name in measured[0]
    }


def score_by_count(records: Sequence[EpisodeRecord]) -> dict[int, dict[str, Estimate]]:
    """Return every metric by the number of objects in the heap, fewest first."""
    counts = sorted({record.count for record in records})
    return {count: score(r for r in records if r.count == count) for count in counts}


def _checked(values: ArrayLike) -> Floats:
    x: Floats = np.asarray(values, dtype=np.float64).reshape(-1)
    if not len(x):
        raise MechSearchError("there is nothing to average; expected at least one value")
    return x
