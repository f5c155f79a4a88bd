"""How good predicted qualities are, against what happened."""

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
    """

    grasps: int
    base_rate: float
    average_precision: float
    auc: float
    brier: float
    calibration_error: float


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
        float(((q - won) ** 2).mean()), error,
    )  # fmt: skip


def average_precision(quality: Floats, success: Array) -> float:
    """Return the mean precision over all successes; equal qualities count as one step."""
    order = np.argsort(-quality, kind="stable")
    ranked, won = quality[order], np.cumsum(success[order])
    ends = np.flatnonzero(np.append(np.diff(ranked) != 0, True))
    gained = np.diff(won[ends], prepend=0)
    return float((gained * won[ends] / (ends + 1)).sum() / won[-1])


def auc(quality: Floats, success: Array) -> float:
    """Return the chance that a random success is rated above a random failure, ties half."""
    failures = np.sort(quality[~success])
    below = np.searchsorted(failures, quality[success], "left")
    up_to = np.searchsorted(failures, quality[success], "right")
    return float((below + up_to).mean() / 2 / len(failures))


def reliability(quality: Floats, success: Array, bins: int = 10) -> Floats:
    """Return mean quality, share of successes and count (b, 3) of each filled bin of quality."""
    place = np.minimum((quality * bins).astype(int), bins - 1)
    rows = [
        (quality[own].mean(), success[own].mean(), own.sum())
        for own in (place == i for i in range(bins))
        if own.any()
    ]
    return np.array(rows, np.float64)
