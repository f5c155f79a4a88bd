"""Who acts: Thompson choice among actor and teachers, with commitment (AC-Teach)."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import erf, sqrt
from typing import Any

import numpy as np

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


@dataclass(frozen=True)
class GuidanceConfig:
    """How readily the behaviour changes hands.

    AC-Teach's threshold of 0.6 cuts most pushes short, and half a push is worth little and teaches
    little; with 1 an episode is mostly one candidate's, unless another is far better.

    Attributes:
        threshold: Probability of improvement above which another candidate takes over.
        decay: What multiplies the threshold each time a better sample was overruled (AC-Teach).
        precision: Precision of an observed return, AC-Teach's tau: 10 where rewards are scaled by
            0.1, in units of the reward itself.
    """

    threshold: float = 1.0
    decay: float = 0.99
    precision: float = 0.1

    def __post_init__(self) -> None:
        if not (0 <= self.threshold <= 1 and 0 < self.decay <= 1 and self.precision > 0):
            raise MechSearchError(
                f"guidance has threshold {self.threshold}, decay {self.decay} and precision "
                f"{self.precision}; expected [0, 1], (0, 1] and a positive number"
            )


class Guidance:
    """Chooses one of several proposed actions from samples of their Q.

    The sign is the one that AC-Teach's authors describe: a candidate takes over when it is
    probably better. Their released code has it inverted.
    """

    def __init__(self, config: GuidanceConfig) -> None:
        self.config = config
        self.reset()

    def reset(self) -> None:
        """Begin an episode: nobody is committed to."""
        self.current: int | None = None
        self.overruled = 0

    def state(self) -> dict[str, Any]:
        """Return who is committed to, as JSON, for `restore`."""
        return {"current": self.current, "overruled": self.overruled}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on in the middle of an episode."""
        self.current, self.overruled = state["current"], state["overruled"]

    def choose(self, samples: Floats, rng: np.random.Generator) -> int:
        """Return the index of the candidate that acts.

        Args:
            samples: Q (S, M) of M candidates under S draws of the critic; a row is one draw.
            rng: Picks the draw that scores all candidates.
        """
        best = int(np.argmax(samples[rng.integers(len(samples))]))
        if self.current is None:
            self.current = best
        elif best != self.current:
            self._consider(best, samples)
        return self.current

    def _consider(self, best: int, samples: Floats) -> None:
        bar = self.config.threshold * self.config.decay**self.overruled
        new, old = belief(samples[:, best]), belief(samples[:, self.current])
        if probability_better(new, old, self.config.precision) > bar:
            self.current, self.overruled = best, 0
        else:
            self.overruled += 1
