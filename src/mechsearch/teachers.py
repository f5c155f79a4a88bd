"""Scripted policies on privileged positions, which suggest actions while learning, by name."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from mechsearch.entry_point import called, conforming, is_entry_point, load_entry_point
from mechsearch.pushes.push import Shape, spiral, straight, zigzag
from mechsearch.pushes.route import Route
from mechsearch.types import TEACHER_KEYS, MechSearchError, Observation, Policy


@runtime_checkable
class Teacher(Policy, Protocol):
    """A policy that can be kept in the middle of an episode.

    It may be asked in any state, whether or not its last suggestion was executed.
    """

    def state(self) -> dict[str, Any]:
        """Return all that its next actions depend on besides what it sees, as JSON."""

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take back what `state` returned."""


class PushTeacher:
    """Pushes above the target, in one shape, again and again (paper, section III-C)."""

    keys: tuple[str, ...] = TEACHER_KEYS

    def __init__(self, shape: Shape, direction: float | None = None) -> None:
        """Begin without a push.

        Args:
            shape: Of its pushes.
            direction: Of the first push [rad], or None for a random one; later ones are random.
        """
        self._shape, self._direction = shape, direction
        self.reset(np.random.default_rng(0))

    def reset(self, rng: np.random.Generator) -> None:
        """Forget the current push; directions come from `rng`."""
        self._rng, self._next_direction, self._route = rng, self._direction, Route()

    def state(self) -> dict[str, Any]:
        """Return how far the current push is, as JSON, for `restore`."""
        generator = self._rng.bit_generator.state
        return {"rng": generator, "next_direction": self._next_direction, **self._route.state()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on with a push exactly where `state` was asked for it."""
        self._rng = np.random.default_rng()
        self._rng.bit_generator.state = state["rng"]
        self._next_direction = state["next_direction"]
        self._route.restore(state)

    def act(self, obs: Observation) -> NDArray[np.float32]:
        """Return the next action (3,) of the current push, or of another where that is done."""
        ee = np.asarray(obs["ee_position"], np.float64)
        target = ee + obs["target_offset"]
        present = np.asarray(obs["clutter_mask"], bool)
        clutter = ee + np.asarray(obs["clutter_offsets"], np.float64)[present]
        for _ in range(2):
            if not len(self._route.waypoints):
                path = self._shape(target[:2], self._draw_direction())
                self._route.begin(path, ee, target, clutter)
            action = self._route.next(ee, target, clutter)
            if action is not None:
                return action
        return np.zeros(3, np.float32)

    def _draw_direction(self) -> float:
        direction, self._next_direction = self._next_direction, None
        return float(self._rng.uniform(0, 2 * np.pi)) if direction is None else direction


TEACHERS: dict[str, Callable[[], Teacher]] = {
    "straight": partial(PushTeacher, straight),
    "zigzag": partial(PushTeacher, zigzag),
    "spiral": partial(PushTeacher, spiral),
}
"""What makes each teacher that has a name. Nothing is done for all of them: whoever means the
paper's three says so."""

PAPER_TEACHERS = ("straight", "zigzag", "spiral")
"""The teachers of the paper (section III-C)."""


def check_teacher(spec: str) -> None:
    """Check a teacher's name without making it.

    Raises:
        MechSearchError: If it is neither in `TEACHERS` nor has the form `package.module:factory`.
    """
    if spec not in TEACHERS and not is_entry_point(spec):
        raise MechSearchError(
            f"unknown teacher {spec!r}; choose among {', '.join(TEACHERS)}, or name a function or "
            "class that makes one as package.module:factory"
        )


def make_teacher(spec: str) -> Teacher:
    """Return the teacher that a text names.

    Args:
        spec: A name in `TEACHERS`, or `package.module:factory`, a function without arguments, or a
            class, that returns a `Teacher`.

    Raises:
        MechSearchError: If there is no such teacher, or it cannot be made.
    """
    check_teacher(spec)
    made = called(TEACHERS.get(spec) or load_entry_point(spec, "teacher"), "teacher", spec)
    members = ("keys", "reset(rng)", "act(obs)", "state()", "restore(state)")
    teacher: Teacher = conforming(made, "teacher", spec, members)
    return teacher
