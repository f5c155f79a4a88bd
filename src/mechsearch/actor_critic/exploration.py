"""Noise on the actor's action while it learns."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mechsearch.types import MechSearchError


@dataclass(frozen=True)
class NoiseConfig:
    """Gaussian noise, correlated in time or not.

    Attributes:
        scale: Standard deviation along each axis, in actions (AC-Teach: 0.2).
        correlation: Of one action's noise with the next one's; 0 is independent noise.
    """

    scale: float = 0.2
    correlation: float = 0.0

    def __post_init__(self) -> None:
        if self.scale < 0 or not 0 <= self.correlation < 1:
            raise MechSearchError(
                f"noise has scale {self.scale} and correlation {self.correlation}; "
                "expected at least 0 and [0, 1)"
            )


class Noise:
    """Noise whose spread is the same at every action of an episode."""

    def __init__(self, config: NoiseConfig) -> None:
        self.config = config
        self.reset()

    def reset(self) -> None:
        """Begin an episode: the next noise is independent of the last."""
        self._last: NDArray[np.float64] | None = None

    def state(self) -> dict[str, Any]:
        """Return the last noise, as JSON, for `restore`."""
        return {"last": None if self._last is None else self._last.tolist()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on in the middle of an episode."""
        self._last = None if state["last"] is None else np.array(state["last"])

    def added(self, action: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
        """Return an action (3,) with noise, clipped to [-1, 1]."""
        fresh = rng.normal(0, self.config.scale, np.shape(action))
        if self._last is None:
            self._last = fresh
        else:
            rho = self.config.correlation
            self._last = rho * self._last + sqrt(1 - rho**2) * fresh
        return np.clip(action + self._last, -1, 1).astype(np.float32)
