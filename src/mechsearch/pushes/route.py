"""Carries out a push by ordinary actions: the way to its start, and its waypoints."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mechsearch.geometry import cap_length
from mechsearch.types import ACTION_LENGTH, Floats

_HIGHEST_PUSH = 0.2


@dataclass(frozen=True)
class RouteConfig:
    """How a push is approached and followed.

    Attributes:
        clearance: Height of the push above the target's point [m].
        lowest: Least height of the fingertip while pushing [m].
        travel_clearance: Height of the approach above the highest object's point [m].
        highest: Greatest height of the fingertip [m].
        half: Bound on the waypoints' horizontal coordinates [m].
        tolerance: Distance at which a waypoint counts as reached [m].
        patience: Actions without progress after which a waypoint is given up.
        beside: Horizontal distance at which the approach may pass an object [m].
        above: Height above an object at which it may pass over it [m].
    """

    clearance: float = 0.03
    lowest: float = 0.02
    travel_clearance: float = 0.09
    highest: float = 0.24
    half: float = 0.29
    tolerance: float = 0.012
    patience: int = 2
    beside: float = 0.08
    above: float = 0.06


class Route:
    """A way from the end effector through the waypoints of a push.

    It may be asked in any state, whether or not its last action was executed: it rejoins the push
    where it is near, and approaches its start again where it is not.

    Attributes:
        push: Waypoints of the push (N, 3) [m].
        waypoints: What is left of the way (M, 3) [m].
    """

    def __init__(self, config: RouteConfig | None = None) -> None:
        """Begin without a push."""
        self.config = config or RouteConfig()
        self.push = np.zeros((0, 3))
        self._follow(self.push)

    def begin(self, path: Floats, ee: Floats, target: Floats, others: Floats) -> None:
        """Take up a push.

        Args:
            path: Its waypoints (N, 2) [m].
            ee: End effector (3,) [m].
            target: A point of the target (3,) [m], above which the push goes.
            others: Points of what else is in the way (M, 3) [m].
        """
        config = self.config
        height = np.clip(target[2] + config.clearance, config.lowest, _HIGHEST_PUSH)
        self.push = np.full((len(path), 3), height)
        self.push[:, :2] = np.clip(path, -config.half, config.half)
        self._approach(ee, target, others)

    def next(self, ee: Floats, target: Floats, others: Floats) -> NDArray[np.float32] | None:
        """Return the next action (3,), or None at the end; arguments are those of `begin`."""
        if len(self.waypoints):
            self._rejoin(ee, target, others)
        self._advance(ee)
        if not len(self.waypoints):
            return None
        step = cap_length(self.waypoints[0] - ee, ACTION_LENGTH)
        return (step / ACTION_LENGTH).astype(np.float32)

    def state(self) -> dict[str, Any]:
        """Return how far the way is gone, as JSON, for `restore`."""
        return {
            "push": self.push.tolist(),
            "waypoints": self.waypoints.tolist(),
            "closest": None if np.isinf(self._closest) else self._closest,
            "stalled": self._stalled,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on exactly where `state` was asked for it."""
        self.push = np.array(state["push"]).reshape(-1, 3)
        self.waypoints = np.array(state["waypoints"]).reshape(-1, 3)
        self._closest = np.inf if state["closest"] is None else state["closest"]
        self._stalled = state["stalled"]

    def _approach(self, ee: Floats, target: Floats, others: Floats) -> None:
        """Go to the push's start: at its height where nothing lies between, else over the heap."""
        start = self.push[0]
        objects = np.vstack([target, others])
        highest = max(objects[:, 2].max(), start[2] - self.config.travel_clearance)
        travel = min(highest + self.config.travel_clearance, self.config.highest)
        way: list[Floats] = []
        if not self._is_clear(ee, start, objects):
            if ee[2] < travel - 0.03 and not self._is_clear(ee, ee, objects):
                way.append(np.array([ee[0], ee[1], travel]))
            way.append(np.array([start[0], start[1], travel]))
        self._follow(np.vstack([*way, self.push]) if way else self.push)

    def _rejoin(self, ee: Floats, target: Floats, others: Floats) -> None:
        """Approach again if something else has carried the end effector away from the way."""
        if float(np.linalg.norm(self.waypoints[0] - ee)) <= self._closest + 0.06:
            return
        near = [i for i, w in enumerate(self.waypoints) if np.linalg.norm(w - ee) < 0.06]
        if near:
            self._follow(self.waypoints[near[-1] :])
        else:
            self._approach(ee, target, others)

    def _advance(self, ee: Floats) -> None:
        """Drop waypoints that are reached, or that a jam keeps out of reach."""
        while len(self.waypoints):
            distance = float(np.linalg.norm(self.waypoints[0] - ee))
            self._stalled = self._stalled + 1 if distance > self._closest - 0.004 else 0
            self._closest = min(self._closest, distance)
            if distance > self.config.tolerance and self._stalled < self.config.patience:
                return
            self._follow(self.waypoints[1:])

    def _follow(self, waypoints: Floats) -> None:
        self.waypoints = waypoints
        self._closest = np.inf
        self._stalled = 0

    def _is_clear(self, start: Floats, end: Floats, objects: Floats) -> bool:
        """Return whether a straight motion passes beside or above all objects (N, 3)."""
        span = end - start
        # No motion has no length to divide by; all that lies along it is its start.
        length = max(float(span @ span), np.finfo(float).tiny)
        along = np.clip((objects - start) @ span / length, 0, 1)
        nearest = start + along[:, None] * span
        beside = np.linalg.norm((objects - nearest)[:, :2], axis=1) > self.config.beside
        above = nearest[:, 2] > objects[:, 2] + self.config.above
        return bool((beside | above).all())
