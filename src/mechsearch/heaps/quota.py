"""Bookkeeping of attempts: which are accepted, and which are still to be made."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from mechsearch.heaps.dataset import heap_from_json, heap_to_json
from mechsearch.heaps.heap import Heap
from mechsearch.types import MechSearchError


@dataclass(frozen=True)
class Drop:
    """One attempt, and what came of it.

    Attributes:
        count: Objects in each heap.
        number: Which attempt at this count.
        heap: None until it is done, and if it is discarded.
        lost: Why two workers did not finish it, if so.
    """

    count: int
    number: int
    heap: Heap | None = None
    lost: str | None = None

    def row(self) -> dict[str, Any]:
        """Return the journal's record."""
        heap = None if self.heap is None else heap_to_json(self.heap)
        row = {"count": self.count, "number": self.number, "heap": heap}
        return row | ({"lost": self.lost} if self.lost else {})


@dataclass
class Quota:
    """Heaps of one object count.

    Attributes:
        count: Objects in each heap.
        size: How many heaps are needed.
        heaps: Those accepted, in the order of their attempts.
        tried: Attempts so far.
        lost: Why workers did not finish an attempt, by its number.
    """

    count: int
    size: int
    heaps: list[Heap] = field(default_factory=list)
    tried: int = 0
    lost: dict[str, str] = field(default_factory=dict)

    @property
    def full(self) -> bool:
        """Whether no more are needed."""
        return len(self.heaps) == self.size

    def resume(self, row: Mapping[str, Any]) -> None:
        """Take the next attempt from a journal; any other is passed over."""
        if row["number"] == self.tried and not self.full:
            heap = None if row["heap"] is None else heap_from_json(row["heap"])
            self.add(Drop(self.count, self.tried, heap, row.get("lost")))

    def add(self, drop: Drop) -> None:
        """Take the next attempt.

        Raises:
            MechSearchError: If hardly any are accepted.
        """
        self.tried += 1
        if drop.lost is not None:
            self.lost[str(drop.number)] = drop.lost
        if drop.heap is not None:
            self.heaps.append(drop.heap)
        elif self.tried >= 200 and len(self.heaps) < self.tried / 200:
            raise MechSearchError(
                f"only {len(self.heaps)} of {self.tried} drops of {self.count} objects were "
                "accepted; these objects hardly ever hide each other under these conditions"
                + (f"; {len(self.lost)} drops were lost: {drop.lost}" if drop.lost else "")
            )


def drops_until_full(quotas: Iterable[Quota]) -> Iterator[Drop]:
    """Yield attempts until the quotas are full, one object count after another."""
    for quota in quotas:
        number = quota.tried
        while not quota.full:
            yield Drop(quota.count, number)
            number += 1
