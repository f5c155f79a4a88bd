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
        travel_clearance: Height of the approach above the highest object's point [m]; in full
            steps above what it passes.
        highest: Greatest height of the fingertip [m].
        half: Bound on the waypoints' horizontal coordinates [m].
        tolerance: Distance at which a waypoint counts as reached [m].
        patience: Actions without progress after which a waypoint is given up.
        beside: Horizontal distance at which the approach may pass an object [m].
        above: Height above an object at which it may pass over it [m].
        full_steps: Whether every action has its full length and cuts corners, and the approach
            goes over no more than what lies on its way; or an action ends at each waypoint.
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
    full_steps: bool = False


class Route:
    """A way from the end effector through the waypoints of a push.

    It may be asked in any state, whether or not its last action was executed: it rejoins the push
    where it is near, and approaches its start again where it is not.

    Attributes:
        push: Waypoints of the push (N, 3) [m].
        approach: The last one, to its start.
        waypoints: What is left of the way (M, 3) [m].
    """

    def __init__(self, config: RouteConfig | None = None) -> None:
        """Begin without a push."""
        self.config = config or RouteConfig()
        self.push = np.zeros((0, 3))
        self.approach: Approaches | None = None
        self._follow(self.push)

    def begin(self, path: Floats, ee: Floats, target: Floats, others: Floats) -> None:
        """Take up a push.

        Args:
            path: Its waypoints (N, 2) [m].
            ee: End effector (3,) [m].
            target: A point of the target (3,) [m], above which the push goes.
            others: Points of what else is in the way (M, 3) [m].
        """
        self.push = waypoints_along(path, target, self.config.clearance, self.config)
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
        """Go to the push's start."""
        self.approach = approaches(self.push[:1], ee, target, others, self.config)
        way = self.approach.corners[0]
        turns = np.linalg.norm(np.diff([ee, *way, self.push[0]], axis=0), axis=1) > 0
        # Nothing turns at the end effector, nor twice at the push's start.
        way = np.vstack([way[turns[:-1] & turns[1:]], self.push])
        self._follow(steps_along(ee, way) if self.config.full_steps else way)

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


def steps_along(start: Floats, way: Floats) -> Floats:
    """Return points (M, 3) [m] on a way, each an action's length from the one before, and its end.

    Args:
        start: From where the first is as far (3,) [m].
        way: Corners of the way from there (N, 3) [m].
    """
    points, here, corner, left = [], start, start, list(way)
    while left:
        if np.linalg.norm(left[0] - here) <= ACTION_LENGTH:
            corner = left.pop(0)
            continue
        # Where the leg that begins within reach leaves it.
        behind, leg = corner - here, left[0] - corner
        a, b, c = leg @ leg, behind @ leg, behind @ behind - ACTION_LENGTH**2
        here = corner = corner + (np.sqrt(b * b - a * c) - b) / a * leg
        points.append(here)
    return np.array([*points, *way[-1:]]).reshape(-1, 3)


def waypoints_along(
    path: Floats, target: Floats, clearance: float | Floats, config: RouteConfig
) -> Floats:
    """Return waypoints (N, 3) [m] of a push along a path (N, 2) [m]; see `Route.begin`.

    Args:
        path: Of one push, or of several.
        target: A point of the target (3,) [m].
        clearance: Height above that [m], of all or of each (N,).
        config: What bounds them.
    """
    waypoints = np.empty((len(path), 3))
    waypoints[:, :2] = np.clip(path, -config.half, config.half)
    waypoints[:, 2] = np.clip(target[2] + clearance, config.lowest, _HIGHEST_PUSH)
    return waypoints


@dataclass(frozen=True)
class Approaches:
    """Ways to the starts of n pushes: straight where nothing lies between, else over it.

    Attributes:
        flies: Which go over something (n,).
        corners: Between the end effector and the starts (n, K, 3) [m]; a way that has fewer is
            at its ends for the others.
    """

    flies: NDArray[np.bool_]
    corners: Floats


def approaches(
    starts: Floats, ee: Floats, target: Floats, others: Floats, config: RouteConfig
) -> Approaches:
    """Return the ways to the starts (n, 3) [m] of pushes; see `Route.begin`."""
    objects = np.vstack([target, others])
    if config.full_steps:
        return _over_what_lies_between(starts, ee, objects, config)
    clear = _are_clear(ee, np.vstack([starts, ee]), objects, config)
    highest = np.maximum(objects[:, 2].max(), starts[:, 2] - config.travel_clearance)
    travel = np.minimum(highest + config.travel_clearance, config.highest)
    flies = ~clear[:-1]
    # Straight up at first where it is not above everything yet.
    rises = flies & (ee[2] < travel - 0.03) & ~clear[-1]
    corners = np.stack([np.broadcast_to(ee, starts.shape), starts], axis=1)
    corners[:, 0, 2][rises] = travel[rises]
    corners[:, 1, 2][flies] = travel[flies]
    return Approaches(flies, corners)


_POSTS = 16
"""Places along an approach at which what lies there is measured, both ends among them."""


def _over_what_lies_between(
    starts: Floats, ee: Floats, objects: Floats, config: RouteConfig
) -> Approaches:
    """Return the shortest ways that pass above all that lies beside them."""
    span = starts[:, :2] - ee[:2]
    length = np.maximum((span * span).sum(axis=1), np.finfo(float).tiny)
    x, y = (objects[:, :2] - ee[:2]).T
    along = np.clip((span[:, :1] * x + span[:, 1:] * y) / length[:, None], 0, 1)
    beside = np.hypot(x - along * span[:, :1], y - along * span[:, 1:]) <= config.beside
    way, point = np.nonzero(beside)
    least = np.zeros((len(starts), _POSTS))
    post = np.rint(along[way, point] * (_POSTS - 1)).astype(np.intp)
    np.maximum.at(least, (way, post), objects[point, 2] + config.travel_clearance)
    np.minimum(least, config.highest, out=least)
    share = np.linspace(0, 1, _POSTS)
    straight = ee[2] + share * (starts[:, 2:] - ee[2])
    corners = np.empty((len(starts), _POSTS, 3))
    corners[..., :2] = ee[:2] + share[:, None] * span[:, None]
    corners[..., 2] = _hull(np.maximum(least, straight))
    return Approaches((least > straight).any(axis=1), corners)


def _hull(heights: Floats) -> Floats:
    """Return the least concave heights that are nowhere below these (n, K), evenly spaced."""
    hull = heights.copy()
    number = heights.shape[1]
    for place in range(1, number - 1):
        before, after = place - np.arange(place), np.arange(1, number - place)
        share = after / (before[:, None] + after)
        chords = heights[:, :place, None] * share + heights[:, None, place + 1 :] * (1 - share)
        np.maximum(hull[:, place], chords.max(axis=(1, 2)), out=hull[:, place])
    return hull


def _are_clear(
    start: Floats, ends: Floats, objects: Floats, config: RouteConfig
) -> NDArray[np.bool_]:
    """Return which straight motions to ends (n, 3) pass beside or above all objects (N, 3)."""
    span = ends - start
    # No motion has no length to divide by; all that lies along it is its start.
    length = np.maximum((span * span).sum(axis=1), np.finfo(float).tiny)
    away = objects - start
    along = np.clip(span @ away.T / length[:, None], 0, 1)
    x, y, z = (away[:, i] - along * span[:, i, None] for i in range(3))
    passes = (x * x + y * y > config.beside**2) | (z < -config.above)
    return np.asarray(passes.all(axis=1))
