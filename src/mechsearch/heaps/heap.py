"""One heap: which objects lie where, and which of them is the target; and some of many heaps."""

from dataclasses import dataclass

from mechsearch.types import Floats, MechSearchError

CONDITIONS = {"single": (5, 10, 15), "dual": (5, 6, 7, 8, 9, 10)}
"""Objects in each heap (paper, section IV-A): one heap near the centre, or two heaps apart."""


@dataclass(frozen=True)
class Heap:
    """A settled start state.

    Attributes:
        objects: Names (N,), distinct.
        poses: Of all objects at rest (N, 7): centre of mass [m], quaternion (w, x, y, z).
        target: Index of the target among `objects`.
        occlusion: Of the target, from the heap set's camera, in [0, 1].
        seed: Identifies the heap; its evaluation start and all episode randomness derive from it.
        count: Objects in each heap, so N for `single` and N / 2 for `dual`.
        condition: "single" or "dual".
        held_out: Whether the heap is kept for evaluation.
    """

    objects: tuple[str, ...]
    poses: Floats
    target: int
    occlusion: float
    seed: int
    count: int
    condition: str
    held_out: bool


def check_condition(condition: str) -> str:
    """Return the condition.

    Raises:
        MechSearchError: If there is no such condition.
    """
    if condition not in CONDITIONS:
        raise MechSearchError(
            f"unknown condition {condition!r}; choose one of {', '.join(CONDITIONS)}"
        )
    return condition


def evenly_spread(count: int, chosen: int) -> list[int]:
    """Return `chosen` of the indices below `count`, evenly spread.

    Heaps are kept by object count, so an even spread has all counts alike.
    """
    return [i * count // chosen for i in range(chosen)]
