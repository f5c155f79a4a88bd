"""What a push is: shapes (paper, section III-C), place and length, and how it looks in a heap.

Of what images show, no privileged position is read: ways are planned from it alone.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mechsearch.camera import Camera
from mechsearch.pushes.route import Route, RouteConfig
from mechsearch.types import ACTION_LENGTH, Array, Floats, MechSearchError, Observation

Shape = Callable[[Floats, float], Floats]
"""Returns the waypoints (N, 2) [m] of a push about a point (2,) [m], in a direction [rad]."""

REACH = 0.15
"""Horizontal distance from the target at which a teacher's push begins and ends [m]."""

AMPLITUDE, STROKES = 0.035, 6
"""Sideways reach of a zig-zag's stroke [m], and their number."""

INNER, OUTER, SPIRAL_TURNS, SPIRAL_POINTS = 0.02, 0.13, 2.0, 20
"""First and last radius of a teacher's spiral [m], its turns, and its waypoints."""


def straight(
    middle: Floats, direction: float, before: float = REACH, after: float = REACH
) -> Floats:
    """Return both ends (2, 2) of a line through `middle` (2,), from `before` to `after` it [m]."""
    return middle + np.outer([-before, after], _unit(direction))


def zigzag(middle: Floats, direction: float, reach: float = REACH) -> Floats:
    """Return the corners (N, 2) of strokes from side to side of such a line."""
    along = _unit(direction)
    across = np.array([-along[1], along[0]])
    sides = AMPLITUDE * np.array([0, *(-1) ** np.arange(1, STROKES), 0])
    ways = np.linspace(-reach, reach, STROKES + 1)
    return middle + np.outer(ways, along) + np.outer(sides, across)


def spiral(
    middle: Floats, direction: float, turns: float = SPIRAL_TURNS, mirrored: bool = False
) -> Floats:
    """Return points (N, 2) outwards from near `middle`, counter-clockwise if not `mirrored`."""
    turned = np.linspace(0, turns, max(round(turns / SPIRAL_TURNS * SPIRAL_POINTS), 3))
    radii = INNER + (OUTER - INNER) / SPIRAL_TURNS * turned
    angles = direction + (-2 if mirrored else 2) * np.pi * turned
    return middle + np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1)


def _unit(direction: float) -> Floats:
    return np.array([np.cos(direction), np.sin(direction)])


KINDS = ("straight", "spiral")
"""Shapes to choose among. Of random pushes on YCB heaps, zig-zags were the best of six a third less
often than they were drawn, and spirals half as often again."""

_STRAIGHT_SHARE = 0.7


@dataclass(frozen=True)
class Push:
    """One push, relative to where the target is seen.

    Attributes:
        kind: Shape: "straight" or "spiral".
        direction: In which it goes, or in which a spiral sets out [rad].
        lateral: How far to the left of the target's middle a straight push passes [m].
        before: Where a straight push begins, ahead of the target's middle [m].
        after: Where it ends, beyond it [m].
        turns: Of a spiral; each leads 5.5 cm further out.
        height: Of the fingertip above the target's visible middle [m].
        mirrored: Whether a spiral turns clockwise.
    """

    kind: str
    direction: float
    lateral: float = 0.0
    before: float = 0.0
    after: float = 0.0
    turns: float = 0.0
    height: float = 0.0
    mirrored: bool = False

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise MechSearchError(
                f"unknown kind of push {self.kind!r}; choose one of {', '.join(KINDS)}"
            )
        if (self.before + self.after if self.kind == "straight" else self.turns) <= 0:
            raise MechSearchError(
                f"a {self.kind} push of {self.before} + {self.after} m and {self.turns} turns has "
                "no length; expected more than 0"
            )

    @property
    def axes(self) -> tuple[Floats, Floats]:
        """The push's own axes (2,) each: along it, and to the left, or right where mirrored."""
        along = _unit(self.direction)
        side = -1.0 if self.mirrored else 1.0
        return along, side * np.array([-along[1], along[0]])

    def middle(self, centre: Floats) -> Floats:
        """Return the point (2,) [m] that it passes beside or through a target at `centre`."""
        along = _unit(self.direction)
        return centre[:2] + self.lateral * np.array([-along[1], along[0]])

    def path(self, centre: Floats) -> Floats:
        """Return its waypoints (N, 2) [m] about a target at `centre`."""
        middle = self.middle(centre)
        if self.kind == "spiral":
            return spiral(middle, self.direction, self.turns, self.mirrored)
        return straight(middle, self.direction, self.before, self.after)


def draw_pushes(count: int, rng: np.random.Generator) -> list[Push]:
    """Return random pushes from all sides; lengths and heights are those that often do well."""
    return [_draw(rng) for _ in range(count)]


def _draw(rng: np.random.Generator) -> Push:
    direction, height = float(rng.uniform(0, 2 * np.pi)), float(rng.uniform(-0.012, 0.035))
    if rng.random() < _STRAIGHT_SHARE:
        lateral, before = float(rng.normal(0, 0.025)), float(rng.uniform(0, 0.11))
        after = float(rng.uniform(0.03, 0.15))
        return Push("straight", direction, lateral, before, after, height=height)
    lateral, turns = float(rng.normal(0, 0.01)), float(rng.uniform(0.75, SPIRAL_TURNS))
    mirrored = bool(rng.random() < 0.5)
    return Push("spiral", direction, lateral, turns=turns, height=height, mirrored=mirrored)


PATCH = (4, 32, 32)
"""Channels, rows and columns of a patch. Along a row the push goes forward, along a column to its
left (right, where it is mirrored); the channels are the height above the table and that above the
fingertip, both in decimetres, the visible target, and the push's own path."""

_WIDTH = 0.025
"""Distance from the path at which it is no longer drawn [m]: twice the end effector's radius."""

CELL = 0.011
"""Side of a patch's pixel [m]: that of an image of 64 px on the table."""

NUMBERS = 15
"""How many numbers describe a push beside its patch."""

MIRRORED_NUMBERS = (0, 12)
"""Which of them change their sign where left and right are exchanged."""

STRAIGHT_NUMBER = 8
"""Which of them is 1 for straight pushes and 0 for others."""

_FINGERS = 0.022
"""Distance from the end effector's axis within which a point is taken for the fingers [m]."""

_ABOVE_HEAPS = 0.3
_ON_TABLE = 0.012
"""Points lower than this belong to the table [m]; depth is known to half a millimetre."""

_SEEN = RouteConfig(travel_clearance=0.03, beside=0.035, above=0.02)
"""Teachers know the middles of objects, and keep away from them; a camera sees their surfaces."""


@dataclass(frozen=True)
class Sight:
    """A heap as a camera sees it.

    Attributes:
        heights: Above the table, by pixel (H, W) [m]; 0 where the end effector hides it.
        target: Visible pixels of the target (H, W).
        centre: Middle of the target's visible surface (3,) [m], or None where none is visible.
        obstacles: Points on everything that stands on the table (N, 3) [m].
        ee_position: End effector (3,) [m].
        camera: Of the images.
    """

    heights: Floats
    target: NDArray[np.bool_]
    centre: Floats | None
    obstacles: Floats
    ee_position: Floats
    camera: Camera


def look(obs: Observation, camera: Camera) -> Sight:
    """Return what an observation shows.

    Args:
        obs: With "depth", "position_image" and "ee_position".
        camera: Of its images.

    Raises:
        MechSearchError: If the images have another size than the camera's.
    """
    points = camera.back_project(np.asarray(obs["depth"])[0])
    ee = np.asarray(obs["ee_position"], np.float64)
    heights = np.where(_is_end_effector(points, ee), 0.0, points[..., 2])
    offsets = np.asarray(obs["position_image"], np.float64)
    target: NDArray[np.bool_] = (offsets != 0).any(axis=0)
    centre = offsets[:, target].mean(axis=1) + ee if target.any() else None
    standing = (heights > _ON_TABLE) & _every_second(*heights.shape)
    return Sight(heights, target, centre, points[standing], ee, camera)


def _is_end_effector(points: Floats, ee: Floats) -> Array:
    away = points - ee
    beside = np.hypot(away[..., 0], away[..., 1]) < _FINGERS
    return (beside & (away[..., 2] > -0.01)) | (points[..., 2] > _ABOVE_HEAPS)


@lru_cache(maxsize=8)
def _every_second(height: int, width: int) -> NDArray[np.bool_]:
    """Return every second pixel of every second row: enough to find a way between objects."""
    mask = np.zeros((height, width), np.bool_)
    mask[::2, ::2] = True
    return mask


class PlannedPush:
    """One push, where the target was seen before it begins.

    Attributes:
        path: Its waypoints (N, 2) [m].
        start: Where the push begins (3,) [m].
        approach: Actions that the way to there will take, as planned.
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
        self._target, self._others = sight.centre, sight.obstacles
        self._route = Route(replace(_SEEN, clearance=push.height))
        self._route.begin(push.path(self._target), sight.ee_position, self._target, self._others)
        self.path = self._route.push[:, :2].copy()
        way = np.vstack([sight.ee_position, self._route.waypoints])
        first = len(way) - len(self._route.push)
        self.start = way[first]
        self.flies = first > 1
        self.approach = self._actions(way[: first + 1])
        self.length = self._actions(way[first:])

    def act(self, obs: Observation) -> NDArray[np.float32] | None:
        """Return the next action (3,), or None at the end; "ee_position" is read."""
        return self._route.next(
            np.asarray(obs["ee_position"], np.float64), self._target, self._others
        )

    def _actions(self, way: Floats) -> float:
        """Return how many actions a way takes; a waypoint counts as reached from nearby."""
        lengths = np.linalg.norm(np.diff(way, axis=0), axis=1) - self._route.config.tolerance
        return float(np.ceil(np.maximum(lengths, 0) / ACTION_LENGTH).sum())


@dataclass(frozen=True)
class PushViews:
    """How n pushes look from one observation.

    Attributes:
        patches: Images in the pushes' frames, n of the shape `PATCH`.
        numbers: Place, lengths, heights and kind, roughly of size 1 (n, NUMBERS).
        actions: How many each will take, approach included, as planned (n,).
    """

    patches: NDArray[np.float16]
    numbers: NDArray[np.float32]
    actions: NDArray[np.float32]


def view_pushes(pushes: Sequence[Push], sight: Sight) -> PushViews:
    """Return how pushes look.

    Raises:
        MechSearchError: If no part of the target is visible.
    """
    planned = [PlannedPush(push, sight) for push in pushes]
    heights = np.array([plan.start[2] for plan in planned])
    numbers = [_numbers(push, plan, sight) for push, plan in zip(pushes, planned, strict=True)]
    actions = [plan.approach + plan.length for plan in planned]
    return PushViews(
        _patches(pushes, heights, sight),
        np.array(numbers, np.float32).reshape(-1, NUMBERS),
        np.array(actions, np.float32),
    )


def _patches(pushes: Sequence[Push], heights: Floats, sight: Sight) -> NDArray[np.float16]:
    assert sight.centre is not None
    axes = np.array([push.axes for push in pushes]).reshape(-1, 2, 1, 1, 2)
    middles = np.array([push.middle(sight.centre) for push in pushes]).reshape(-1, 1, 1, 2)
    u, v = _grid()
    places = middles + u[..., None] * axes[:, 0] + v[..., None] * axes[:, 1]
    level = np.full((*places.shape[:-1], 1), max(sight.centre[2], 0.02))
    pixels = sight.camera.project(np.concatenate([places, level], axis=-1))
    layers = np.stack([sight.heights, sight.target.astype(np.float64)])
    height, target = _sample(layers, pixels[..., 1], pixels[..., 0])
    above = height - heights[:, None, None]
    paths = np.array([_path_image(push) for push in pushes]).reshape(-1, *PATCH[1:])
    return np.stack([10 * height, 10 * above, target, paths], axis=1).astype(np.float16)


@lru_cache(maxsize=1)
def _grid() -> tuple[Floats, Floats]:
    steps = (np.arange(PATCH[1]) - (PATCH[1] - 1) / 2) * CELL
    u, v = np.meshgrid(steps, steps)
    return u, v


def _path_image(push: Push) -> Floats:
    """Return a path in its push's own frame (32, 32): 1 on it, falling to 0 beside it."""
    own = replace(push, direction=0.0, lateral=0.0, mirrored=False)
    way = own.path(np.zeros(2))
    x, y = way[:-1, 0], way[:-1, 1]
    dx, dy = np.diff(way[:, 0]), np.diff(way[:, 1])
    u, v = (axis[..., None] for axis in _grid())
    along = ((u - x) * dx + (v - y) * dy) / (dx * dx + dy * dy)
    along = np.minimum(np.maximum(along, 0), 1)
    away = np.hypot(x + along * dx - u, y + along * dy - v).min(axis=-1)
    image: Floats = np.maximum(1 - away / _WIDTH, 0)
    return image


def _sample(layers: Floats, rows: Floats, columns: Floats) -> Floats:
    """Return images (C, H, W) between pixels, at places (...,); 0 outside: (C, ...)."""
    framed = np.pad(layers, ((0, 0), (1, 1), (1, 1)))
    height, width = framed.shape[1:]
    rows = np.clip(rows + 1, 0, height - 1.001)
    columns = np.clip(columns + 1, 0, width - 1.001)
    row, column = rows.astype(np.intp), columns.astype(np.intp)
    down, right = rows - row, columns - column
    flat, place = framed.reshape(len(framed), -1), row * width + column
    upper = flat[:, place] * (1 - right) + flat[:, place + 1] * right
    lower = flat[:, place + width] * (1 - right) + flat[:, place + width + 1] * right
    sampled: Floats = upper * (1 - down) + lower * down
    return sampled


def _numbers(push: Push, planned: PlannedPush, sight: Sight) -> list[float]:
    assert sight.centre is not None
    along, across = push.axes
    middle, tip = push.middle(sight.centre), planned.start[2]
    away = sight.ee_position[:2] - middle
    return [
        20 * float((middle - sight.centre[:2]) @ across),
        8 * push.before,
        8 * push.after,
        push.turns,
        10 * tip,
        20 * (tip - sight.centre[2]),
        10 * sight.centre[2],
        float(sight.target.mean()) * 100,
        float(push.kind == KINDS[0]),
        planned.approach / 10,
        planned.length / 10,
        4 * float(away @ along),
        4 * float(away @ across),
        5 * (sight.ee_position[2] - tip),
        float(planned.flies),
    ]
