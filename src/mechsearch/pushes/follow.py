"""Carries out one push, from approach to end, by ordinary actions."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mechsearch.pushes.push import Push
from mechsearch.pushes.sight import Sight
from mechsearch.teachers.teacher import PushConfig, Teacher
from mechsearch.types import ACTION_LENGTH, Floats, MechSearchError

_WAY = PushConfig(travel_clearance=0.03, beside=0.035, above=0.02)
"""Teachers know the middles of objects, and keep away from them; a camera sees their surfaces."""


class PushFollower(Teacher):
    """A teacher that pushes once, where the target was seen before the push began.

    Attributes:
        approach: Actions that the way to the push's start will take, as planned.
        length: Actions that the push itself will take, as planned.
        flies: Whether it approaches over the heap.
    """

    def __init__(self, push: Push, sight: Sight) -> None:
        """Plan the way.

        Args:
            push: What to do.
            sight: Where; its target must be visible.

        Raises:
            MechSearchError: If no part of the target is visible.
        """
        if sight.centre is None:
            raise MechSearchError("a push needs a target of which something is visible; got none")
        self._chosen, self._centre, self._obstacles = push, sight.centre, sight.obstacles
        self._finished = False
        super().__init__(push.direction, replace(_WAY, clearance=push.height))
        self._begin(sight.ee_position, self._centre, self._obstacles)
        way = [sight.ee_position, *self._waypoints]
        split = len(way) - len(self._push) + 1
        self.flies = split > 2
        self.approach = _actions(way[:split], self.config.tolerance)
        self.length = _actions(way[split - 1 :], self.config.tolerance)

    @property
    def start(self) -> Floats:
        """Where the push begins (3,) [m]."""
        return self._push[0]

    def path(self, target: Floats, height: float, direction: float) -> Sequence[Floats]:
        """Return the waypoints of the push."""
        return self._chosen.path(target, height)

    def next(self, ee_position: Floats) -> NDArray[np.float32] | None:
        """Return the next action (3,) from where the end effector is (3,) [m]; None at the end."""
        ee = np.asarray(ee_position, np.float64)
        action = self.act(
            {
                "ee_position": ee,
                "target_offset": self._centre - ee,
                "clutter_offsets": self._obstacles - ee,
                "clutter_mask": np.ones(len(self._obstacles), np.bool_),
            }
        )
        return None if self._finished else action

    def _begin(self, ee: Floats, target: Floats, clutter: Floats) -> None:
        """Begin the push, once."""
        if self._next_direction is None:
            self._finished = True
            self._waypoints = [ee]
        else:
            super()._begin(ee, target, clutter)


def _actions(way: Sequence[Floats], tolerance: float) -> float:
    """Return how many actions a way takes; a waypoint counts as reached from nearby."""
    lengths = np.linalg.norm(np.diff(np.array(way), axis=0), axis=1)
    return float(np.ceil(np.maximum(lengths - tolerance, 0) / ACTION_LENGTH).sum())
