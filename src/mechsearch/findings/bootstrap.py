"""Intervals that respect training seeds and heaps: a crossed bootstrap.

A policy trained S times and run on H heaps gives a matrix (S, H). Seeds and heaps are drawn anew
with replacement, each by itself (Owen, 2007, "The pigeonhole bootstrap"); policies on the same
heaps share the draw of heaps, which pairs them, and have their own draws of seeds.

Percentiles of a bootstrap over few seeds are too narrow: n values scatter less about their own
mean than about the true one, and Student's t, not the normal, describes the mean of few. Effects of
seeds and of heaps are therefore stretched by sqrt(n / (n - 1)) t / z before the draw, the
correction that Hesterberg (2015) makes to the percentiles. With one seed the interval covers heaps
only.
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy import stats

from mechsearch.evaluation.episodes import CONFIDENCE, Estimate
from mechsearch.types import Floats, MechSearchError

SAMPLES = 4000
SEED = 0


def replicates(
    matrices: Sequence[Floats], rng: np.random.Generator, samples: int = SAMPLES
) -> Floats:
    """Return resampled means (K, samples) of K policies on the same heaps.

    Args:
        matrices: Values (S_k, H) of each policy, by training seed and heap.
        rng: Draws seeds and heaps.
        samples: Number of draws.

    Raises:
        MechSearchError: If the matrices do not have the same heaps, or one is empty.
    """
    shapes = [np.shape(values) for values in matrices]
    if any(len(shape) != 2 or 0 in shape or shape[1] != shapes[0][1] for shape in shapes):
        raise MechSearchError(
            f"values by seed and heap of shapes {', '.join(map(str, shapes))}; expected the same "
            "heaps in all, and at least one seed and one heap"
        )
    weights = _draws(shapes[0][1], rng, samples)
    means = [
        ((_draws(len(values), rng, samples) @ stretched(values)) * weights).sum(axis=1)
        for values in matrices
    ]
    return np.array(means)


def stretched(values: Floats) -> Floats:
    """Return values (S, H) whose effects of seeds and heaps are corrected for small numbers."""
    mean = values.mean()
    seeds = values.mean(axis=1, keepdims=True) - mean
    heaps = values.mean(axis=0, keepdims=True) - mean
    rest = values - mean - seeds - heaps
    result: Floats = mean + _factor(len(values)) * seeds + _factor(values.shape[1]) * heaps + rest
    return result


def estimated(
    matrices: Sequence[Floats], statistic: Callable[[Floats], Floats] = lambda means: means[0]
) -> Estimate:
    """Return a statistic of policies' means on the same heaps, with its 95 % interval.

    Args:
        matrices: Values (S_k, H) of each of K policies, by training seed and heap.
        statistic: What is asked, (B,) of means (K, B); by default the mean of the first policy.
    """
    point = statistic(np.array([[values.mean()] for values in matrices]))[0]
    drawn = statistic(replicates(matrices, np.random.default_rng(SEED)))
    return percentile_interval(float(point), drawn, matrices[0].shape[1])


def percentile_interval(point: float, draws: Floats, heaps: int) -> Estimate:
    """Return an estimate with its 95 % percentile interval.

    Args:
        point: The statistic of the data themselves.
        draws: The statistic of each draw (samples,).
        heaps: Number of heaps; a single one gives no interval, and neither does a statistic that
            is not defined in more draws than the interval leaves out on one side.
    """
    undefined = float(np.isnan(draws).mean())
    if heaps < 2 or not np.isfinite(point) or undefined > (1 - CONFIDENCE) / 2:
        return Estimate(point, float("nan"), float("nan"), heaps)
    low, high = np.nanpercentile(draws, [50 * (1 - CONFIDENCE), 50 * (1 + CONFIDENCE)])
    return Estimate(point, float(low), float(high), heaps)


def _draws(number: int, rng: np.random.Generator, samples: int) -> Floats:
    """Return how much each of `number` things weighs in every draw (samples, number)."""
    # Numbered through, so that one count over all draws tells them apart.
    chosen = rng.integers(0, number, (samples, number)) + number * np.arange(samples)[:, None]
    counts = np.bincount(chosen.ravel(), minlength=samples * number)
    weights: Floats = counts.reshape(samples, number) / number
    return weights


def _factor(number: int) -> float:
    if number < 2:
        return 1.0
    student = stats.t.ppf((1 + CONFIDENCE) / 2, number - 1)
    normal = stats.norm.ppf((1 + CONFIDENCE) / 2)
    return float(np.sqrt(number / (number - 1)) * student / normal)
