"""Where things are: the table and the box in which the end effector may move."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mechsearch.types import Array, Floats


@dataclass(frozen=True)
class Workspace:
    """A square table at height 0 and the end effector's bounds above it.

    Attributes:
        half: Half the side of the bounds, about the origin [m].
        low: Lowest height of the fingertip [m].
        high: Greatest height of the fingertip [m].
        table_half: Half the side of the table [m].
        floor: Height of the floor around the table [m].
    """

    half: float = 0.3
    low: float = 0.01
    high: float = 0.25
    table_half: float = 0.4
    floor: float = -0.75

    def clip(self, position: Array) -> Floats:
        """Return the nearest position (3,) [m] inside the bounds."""
        low, high = self._bounds
        clipped: Floats = np.minimum(np.maximum(np.asarray(position, np.float64), low), high)
        return clipped

    @cached_property
    def _bounds(self) -> tuple[Floats, Floats]:
        low = np.array([-self.half, -self.half, self.low])
        return low, np.array([self.half, self.half, self.high])

    def sample(self, rng: np.random.Generator) -> Floats:
        """Return a position (3,) [m] drawn uniformly from the bounds."""
        return rng.uniform([-self.half, -self.half, self.low], [self.half, self.half, self.high])

    def off_table(self, positions: Array) -> NDArray[np.bool_]:
        """Return which objects, centres of mass (..., 3) and more, have left the table (...,)."""
        beyond = np.abs(positions[..., :2]).max(axis=-1) > self.table_half
        result: NDArray[np.bool_] = beyond | (positions[..., 2] < -0.05)
        return result
