"""Which heaps are drawn, and which no longer, because workers failed on them."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from mechsearch.heaps.heap import Heap
from mechsearch.types import MechSearchError

STRIKES = 2
"""A heap on which so many workers failed is quarantined."""


class Quarantine:
    """Counts the failures on each heap.

    Attributes:
        names: Seed of each quarantined heap, and why its last worker failed.
    """

    def __init__(self, heaps: Sequence[Heap]) -> None:
        """Begin without any failure."""
        self._heaps = heaps
        self._strikes: Counter[int] = Counter()
        self.names: dict[int, str] = {}

    def __contains__(self, heap: int) -> bool:
        """Whether a heap, by its index, is quarantined."""
        return self._strikes[heap] >= STRIKES

    def strike(self, heap: int, reason: str) -> int | None:
        """Count a failure; return the heap's seed if it is quarantined now."""
        self._strikes[heap] += 1
        if heap not in self:
            return None
        self.names[self._heaps[heap].seed] = reason
        return self._heaps[heap].seed

    def draw(self, rng: np.random.Generator, heap: int | None = None) -> int:
        """Return the index of the heap that was asked for, or of one drawn as `HeapEnv.reset` does.

        Raises:
            MechSearchError: If it does not exist or is quarantined, or all are.
        """
        if heap is not None:
            return self._checked(heap)
        if len(self.names) == len(self._heaps):
            name, reason = list(self.names.items())[-1]
            raise MechSearchError(
                f"all {len(self._heaps)} heaps are quarantined; the last, {name}: {reason}"
            )
        while (drawn := int(rng.integers(len(self._heaps)))) in self:
            pass
        return drawn

    def _checked(self, heap: int) -> int:
        if not 0 <= heap < len(self._heaps):
            raise MechSearchError(f"heap {heap} does not exist; choose 0 to {len(self._heaps) - 1}")
        if heap in self:
            seed = self._heaps[heap].seed
            raise MechSearchError(
                f"heap {heap} (seed {seed}) is quarantined: {self.names[seed]}, {STRIKES} times"
            )
        return heap
