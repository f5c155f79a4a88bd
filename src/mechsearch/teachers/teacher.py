"""A scripted push as a policy: a path of waypoints, followed by ordinary actions.

A teacher reads privileged positions alone and may be asked in any state, whether or not its last
suggestion was executed: it rejoins its path where it is near, approaches the path's start again
where it is not, and begins another push when one is finished.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mechsearch.geometry import cap_length
from mechsearch.types import ACTION_LENGTH, TEACHER_KEYS, Floats, Observation


@dataclass(frozen=True)
class PushConfig:
    """Shape of a push.

    Attributes:
        reach: Horizontal distance from the target at which a straight push begins and ends [m].
        clearance: Height of the push above the target's centre of mass [m].
        lowest: Least height of the fingertip while pushing [m].
        travel_clearance: Height of the approach above the highest centre of mass [m].
        highest: Greatest height of the fingertip [m].
        half: Bound on the path's horizontal coordinates [m].
        tolerance: Distance at which a waypoint counts as reached [m].
        patience: Actions without progress after which a waypoint is given up.
        beside: Horizontal distance at which the approach may pass an object [m].
        above: Height above an object at which it may pass over it [m].
    """

    reach: float = 0.15
    clearance: float = 0.03
    lowest: float = 0.02
    travel_clearance: float = 0.09
    highest: float = 0.24
    half: float = 0.29
    tolerance: float = 0.012
    patience: int = 2
    beside: float = 0.08
    above: float = 0.06


@dataclass
class Teacher:
    """Follows pushes that `path` draws; subclasses say which.

    Attributes:
        direction: Of the first push [rad], or None for a random one; later pushes are random.
        config: Shape of the push.
    """

    direction: float | None = None
    config: PushConfig = field(default_factory=PushConfig)
    keys: tuple[str, ...] = TEACHER_KEYS

    def __post_init__(self) -> None:
        self.reset(np.random.default_rng(0))

    def reset(self, rng: np.random.Generator) -> None:
        """Forget the current push."""
        self._rng = rng
        self._next_direction = self.direction
        self._push: list[Floats] = []
        self._waypoints: list[Floats] = []
        self._closest = np.inf
        self._stalled = 0

    def state(self) -> dict[str, Any]:
        """Return how far the current push is, as JSON, for `restore`."""
        return {
            "rng": self._rng.bit_generator.state,
            "next_direction": self._next_direction,
            "push": [point.tolist() for point in self._push],
            "waypoints": [point.tolist() for point in self._waypoints],
            "closest": None if np.isinf(self._closest) else self._closest,
            "stalled": self._stalled,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on with a push exactly where `state` was asked for it."""
        self._rng = np.random.default_rng()
        self._rng.bit_generator.state = state["rng"]
        self._next_direction = state["next_direction"]
        self._push = [np.array(point) for point in state["push"]]
        self._waypoints = [np.array(point) for point in state["waypoints"]]
        self._closest = np.inf if state["closest"] is None else state["closest"]
        self._stalled = state["stalled"]

    @property
    def waypoints(self) -> list[Floats]:
        """What is left of the current path, points (3,) [m], for drawing."""
        return list(self._waypoints)

    def path(self, target: Floats, height: float, direction: float) -> Sequence[Floats]:
        """Return the waypoints (3,) [m] of one push.

        Args:
            target: Centre of mass of the target (3,) [m].
            height: Of the fingertip while pushing [m].
            direction: Of the push [rad].
        """
        raise NotImplementedError

    def act(self, obs: Observation) -> NDArray[np.float32]:
        """Return the next action (3,) along the path."""
        ee = np.asarray(obs["ee_position"], np.float64)
        target = ee + obs["target_offset"]
        present = np.asarray(obs["clutter_mask"], bool)
        clutter = ee + np.asarray(obs["clutter_offsets"], np.float64)[present]
        if not self._waypoints:
            self._begin(ee, target, clutter)
        self._rejoin(ee, target, clutter)
        self._advance(ee)
        if not self._waypoints:
            self._begin(ee, target, clutter)
            self._advance(ee)
        goal = self._waypoints[0] if self._waypoints else ee
        step = cap_length(goal - ee, ACTION_LENGTH)
        return (step / ACTION_LENGTH).astype(np.float32)

    def _begin(self, ee: Floats, target: Floats, clutter: Floats) -> None:
        direction = self._next_direction
        self._next_direction = None
        if direction is None:
            direction = float(self._rng.uniform(0, 2 * np.pi))
        height = float(np.clip(target[2] + self.config.clearance, self.config.lowest, 0.2))
        self._push = [self._bounded(point) for point in self.path(target, height, direction)]
        self._approach(ee, target, clutter)

    def _approach(self, ee: Floats, target: Floats, clutter: Floats) -> None:
        """Go to the push's start: at its height where nothing lies between, else over the heap."""
        start = self._push[0]
        objects = np.vstack([target, clutter])
        heights = np.array([*objects[:, 2], start[2] - self.config.travel_clearance])
        travel = min(heights.max() + self.config.travel_clearance, self.config.highest)
        way: list[Floats] = []
        if not self._is_clear(ee, start, objects):
            if ee[2] < travel - 0.03 and not self._is_clear(ee, ee, objects):
                way.append(np.array([ee[0], ee[1], travel]))
            way.append(np.array([start[0], start[1], travel]))
        self._follow([*way, *self._push])

    def _rejoin(self, ee: Floats, target: Floats, clutter: Floats) -> None:
        """Approach again if something else has carried the end effector away from the path."""
        goal = self._waypoints[0]
        distance = float(np.linalg.norm(goal - ee))
        if distance <= self._closest + 0.06:
            return
        near = [i for i, w in enumerate(self._waypoints) if np.linalg.norm(w - ee) < 0.06]
        if near:
            self._follow(self._waypoints[near[-1] :])
        else:
            self._approach(ee, target, clutter)

    def _advance(self, ee: Floats) -> None:
        """Drop waypoints that are reached, or that a jam keeps out of reach."""
        while self._waypoints:
            distance = float(np.linalg.norm(self._waypoints[0] - ee))
            self._stalled = self._stalled + 1 if distance > self._closest - 0.004 else 0
            self._closest = min(self._closest, distance)
            if distance > self.config.tolerance and self._stalled < self.config.patience:
                return
            self._follow(self._waypoints[1:])

    def _follow(self, waypoints: list[Floats]) -> None:
        self._waypoints = waypoints
        self._closest = np.inf
        self._stalled = 0

    def _bounded(self, point: Floats) -> Floats:
        half, config = self.config.half, self.config
        return np.clip(point, [-half, -half, config.lowest], [half, half, config.highest])

    def _is_clear(self, start: Floats, end: Floats, objects: Floats) -> bool:
        """Return whether a straight motion passes beside or above all objects (N, 3)."""
        span = end - start
        length = float(span @ span)
        along = (
            np.clip((objects - start) @ span / length, 0, 1)
            if length > 0
            else np.zeros(len(objects))
        )
        nearest = start + along[:, None] * span
        beside = np.linalg.norm((objects - nearest)[:, :2], axis=1) > self.config.beside
        above = nearest[:, 2] > objects[:, 2] + self.config.above
        return bool((beside | above).all())
