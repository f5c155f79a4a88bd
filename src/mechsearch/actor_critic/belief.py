"""What samples of a Bayesian critic say about an action: mean, variance, and which is better."""

from dataclasses import dataclass
from math import erf, sqrt

from mechsearch.types import Floats, MechSearchError


@dataclass(frozen=True)
class Belief:
    """A normal belief about one action's Q.

    Attributes:
        mean: Expected Q.
        variance: Of Q, from the samples.
    """

    mean: float
    variance: float


def belief(samples: Floats) -> Belief:
    """Return the belief that samples (S,) of one action's Q speak for.

    Raises:
        MechSearchError: If there are no samples.
    """
    if not len(samples):
        raise MechSearchError("a belief needs at least one sample of Q")
    return Belief(float(samples.mean()), float(samples.var()))


def probability_better(new: Belief, old: Belief, precision: float) -> float:
    """Return the probability that `new` has a higher value than `old` (AC-Teach's rule).

    Args:
        new: Belief about the candidate.
        old: Belief about the current choice.
        precision: Of an observed return, AC-Teach's tau: 1 / variance.
    """
    spread = sqrt(new.variance + old.variance + 1 / precision)
    return 0.5 * (1 + erf((new.mean - old.mean) / (spread * sqrt(2))))
