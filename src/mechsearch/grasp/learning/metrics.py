"""How good predicted qualities are, against what happened."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mechsearch.types import Array, Floats, MechSearchError


@dataclass(frozen=True)
class Verdict:
    """Predictions against outcomes.

    Attributes:
        grasps: How many.
        base_rate: Share that succeeds; the average precision of guessing.
        average_precision: Mean precision over all successes, ranked by quality.
        auc: Chance that a success is rated above a failure.
        brier: Mean squared error of the quality as a probability.
        calibration_error: Mean distance of quality and share of successes, over ten bins.
        curve: Mean quality, share of successes and count of each bin that is not empty.
    """

    grasps: int
    base_rate: float
    average_precision: float
    auc: float
    brier: float
    calibration_error: float
    curve: list[list[float]]


def judge(quality: Array, success: Array) -> Verdict:
    """Return how good qualities (n,) in [0, 1] are against labels (n,).

    Raises:
        MechSearchError: If sizes differ, or all outcomes are alike.
    """
    q, won = np.asarray(quality, np.float64), np.asarray(success, np.bool_)
    if q.shape != won.shape or q.ndim != 1:
        raise MechSearchError(f"qualities {q.shape} and labels {won.shape} differ in shape")
    if won.all() or not won.any():
        raise MechSearchError(
            f"all {len(won)} grasps {'succeed' if won.all() else 'fail'}; expected some of both"
        )
    shares = reliability(q, won)
    error = float((shares[:, 2] * np.abs(shares[:, 0] - shares[:, 1])).sum() / len(q))
    return Verdict(
        len(q), float(won.mean()), average_precision(q, won), auc(q, won),
        float(((q - won) ** 2).mean()), error, shares.tolist(),
    )  # fmt: skip


def average_precision(quality: Floats, success: Array, weight: Array | None = None) -> float:
    """Return the mean precision over all successes; equal qualities count as one step.

    Args:
        quality: Of each grasp (n,).
        success: Of each grasp (n,).
        weight: How often each grasp counts (n,); once by default.
    """
    order = np.argsort(-quality, kind="stable")
    ranked, counts = quality[order], np.ones(len(order)) if weight is None else weight[order]
    won, tried = np.cumsum(counts * success[order]), np.cumsum(counts)
    ends = np.flatnonzero(np.append(np.diff(ranked) != 0, True) & (tried > 0))
    gained = np.diff(won[ends], prepend=0)
    return float((gained * won[ends] / tried[ends]).sum() / won[-1])


@dataclass(frozen=True)
class Gain:
    """By how much one network's average precision is above another's, and its 95 % interval."""

    mean: float
    low: float
    high: float


def paired_gain(
    ours: Floats, theirs: Floats, success: Array, heap: Array, samples: int = 2000
) -> Gain:
    """Return the gain in average precision on the same grasps, by bootstrap over heaps (seed 0).

    Grasps of a heap are alike, so heaps are drawn with all their grasps, for both networks at once.

    Args:
        ours: Qualities (n,).
        theirs: Qualities (n,) of the same grasps.
        success: Of each grasp (n,).
        heap: To which each grasp belongs (n,).
        samples: Of the bootstrap.
    """
    won = np.asarray(success, np.bool_)
    _, place = np.unique(heap, return_inverse=True)
    heaps = int(place.max()) + 1
    rng = np.random.default_rng(0)

    def gain(weight: Array | None) -> float:
        return average_precision(ours, won, weight) - average_precision(theirs, won, weight)

    gains = []
    for _ in range(samples):
        weight = np.bincount(rng.integers(heaps, size=heaps), minlength=heaps)[place]
        if (weight[won] > 0).any():
            gains.append(gain(weight))
    low, high = np.percentile(gains, [2.5, 97.5])
    return Gain(gain(None), float(low), float(high))


def auc(quality: Floats, success: Array) -> float:
    """Return the chance that a random success is rated above a random failure, ties half."""
    failures, won = np.sort(quality[~success]), quality[success]
    below, up_to = (np.searchsorted(failures, won, side) for side in ("left", "right"))
    return float((below + up_to).mean() / 2 / len(failures))


def reliability(quality: Floats, success: Array, bins: int = 10) -> Floats:
    """Return mean quality, share of successes and count (b, 3) of each filled bin of quality."""
    place = np.minimum((quality * bins).astype(int), bins - 1)
    filled = [place == i for i in np.unique(place)]
    rows = [(quality[own].mean(), success[own].mean(), own.sum()) for own in filled]
    return np.array(rows, np.float64)


@dataclass(frozen=True)
class NetworkComparison:
    """Grasp networks against each other, on the same labelled grasps.

    Attributes:
        heaps: To which the grasps belong, how many.
        networks: Verdict on each, by name.
        gain_over: Of the first network over each other one.
    """

    heaps: int
    networks: Mapping[str, Verdict]
    gain_over: Mapping[str, Gain]


def compare(rated: Mapping[str, Floats], success: Array, heap: Array) -> NetworkComparison:
    """Return how good qualities are, and the gain of the first network over each other one.

    Args:
        rated: Qualities (n,) of the same grasps, by network.
        success: Of each grasp (n,).
        heap: To which each grasp belongs (n,).

    Raises:
        MechSearchError: If all outcomes are alike.
    """
    (_, ours), *others = rated.items()
    verdicts = {name: judge(quality, success) for name, quality in rated.items()}
    gains = {name: paired_gain(ours, quality, success, heap) for name, quality in others}
    return NetworkComparison(len(np.unique(heap)), verdicts, gains)
