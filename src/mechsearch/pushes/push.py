"""What a push is: shapes (paper, section III-C), place and length, and how it looks in a heap.

Of what images show, no privileged position is read: ways are planned from it alone.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mechsearch.camera import Camera
from mechsearch.pushes.route import Approaches, Route, RouteConfig, approaches, waypoints_along
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
    return middle + np.array([[-before], [after]]) * _unit(direction)


def zigzag(middle: Floats, direction: float, reach: float = REACH) -> Floats:
    """Return the corners (N, 2) of strokes from side to side of such a line."""
    along = _unit(direction)
    across = np.array([-along[1], along[0]])
    sides = AMPLITUDE * np.array([0, *(-1) ** np.arange(1, STROKES), 0])
    ways = np.linspace(-reach, reach, STROKES + 1)
    return middle + np.outer(ways, along) + np.outer(sides, across)


def spiral(middle: Floats, direction: float) -> Floats:
    """Return points (N, 2) outwards from near `middle`, counter-clockwise."""
    turned = np.linspace(0, SPIRAL_TURNS, SPIRAL_POINTS)
    radii = INNER + (OUTER - INNER) / SPIRAL_TURNS * turned
    angles = direction + 2 * np.pi * turned
    points: Floats = middle + np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=-1)
    return points


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
        offset: From where the target was seen to where it is looked for [m].
        full_steps: Whether it is carried out by actions of full length, which cut corners.
    """

    kind: str
    direction: float
    lateral: float = 0.0
    before: float = 0.0
    after: float = 0.0
    turns: float = 0.0
    height: float = 0.0
    mirrored: bool = False
    offset: tuple[float, float] = (0.0, 0.0)
    full_steps: bool = False

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

    def about(self, shift: Floats) -> "Push":
        """Return the push that goes the same way about a target that is seen elsewhere.

        A spiral's middle is only moved back sideways.

        Args:
            shift: From where the target was seen to where it is seen now (3,) [m].
        """
        along = _unit(self.direction)
        ahead = float(shift[:2] @ along) if self.kind == "straight" else 0.0
        return replace(
            self,
            lateral=self.lateral - float(shift[1] * along[0] - shift[0] * along[1]),
            before=self.before + ahead,
            after=self.after - ahead,
            height=self.height - float(shift[2]),
        )

    def path(self, centre: Floats) -> Floats:
        """Return its waypoints (N, 2) [m] about a target at `centre`."""
        return _paths([self], _Frames([self], centre))[2]


def draw_pushes(count: int, rng: np.random.Generator, full_steps: bool = False) -> list[Push]:
    """Return random pushes from all sides; lengths and heights are those that often do well."""
    return [_draw(rng, full_steps) for _ in range(count)]


def _draw(rng: np.random.Generator, full_steps: bool) -> Push:
    direction, height = _uniform(0, 2 * np.pi, rng), _uniform(-0.012, 0.035, rng)
    if rng.random() < _STRAIGHT_SHARE:
        lateral, before = float(rng.normal(0, 0.025)), _uniform(0, 0.11, rng)
        after = _uniform(0.03, 0.15, rng)
        return Push(
            "straight", direction, lateral, before, after, height=height, full_steps=full_steps
        )
    lateral, turns = float(rng.normal(0, 0.01)), _uniform(0.75, SPIRAL_TURNS, rng)
    mirrored = bool(rng.random() < 0.5)
    return Push(
        "spiral", direction, lateral,
        turns=turns, height=height, mirrored=mirrored, full_steps=full_steps,
    )  # fmt: skip


def _uniform(low: float, high: float, rng: np.random.Generator) -> float:
    # To the bit `rng.uniform`, which takes five times as long for one number.
    return low + (high - low) * rng.random()


_BULK = 0.03
"""What is near enough to hide a target at a place: the std of a window [m]."""

_LOOKED, _LOOKED_SHARE = 0.05, 0.3
"""Distance within which a place was looked at [m], and how often it is drawn again, relatively."""


def draw_places(
    count: int, heap: Floats, looked: Sequence[Floats], rng: np.random.Generator
) -> Floats:
    """Return places (count, 2) [m] where something hidden may be.

    Places are drawn by the square of how much stands around them, and less often near those
    where it was looked for before.

    Args:
        count: How many.
        heap: Points on everything that stands on the table (N, 3) [m], N at least 1.
        looked: Places (2,) [m] where it was looked for.
        rng: Draws.
    """
    away = ((heap[:, None, :2] - heap[None, :, :2]) ** 2).sum(axis=-1)
    weights: Floats = (np.exp(-0.5 * away / _BULK**2) @ heap[:, 2]) ** 2
    for place in looked:
        near = np.hypot(*(heap[:, :2] - place).T) < _LOOKED
        weights *= np.where(near, _LOOKED_SHARE, 1.0)
    places: Floats = heap[:, :2][rng.choice(len(heap), count, p=weights / weights.sum())]
    return places


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


_UNSEEN = "a push needs a target of which something is visible; got none"


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
        way: The same at its height (N, 3) [m].
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
            raise MechSearchError(_UNSEEN)
        self._target, self._others = sight.centre, sight.obstacles
        self._route = Route(replace(_SEEN, clearance=push.height, full_steps=push.full_steps))
        self._route.begin(push.path(self._target), sight.ee_position, self._target, self._others)
        self.way = self._route.push.copy()
        self.path, self.start = self.way[:, :2], self.way[0]
        assert self._route.approach is not None
        counts = np.array([len(self.way)])
        plan = _Plans(self.way, counts, self._route.approach, push.full_steps, sight.ee_position)
        self.flies, self.approach, self.length = (
            bool(plan.flies[0]), float(plan.approach[0]), float(plan.length[0])
        )  # fmt: skip

    def act(self, obs: Observation) -> NDArray[np.float32] | None:
        """Return the next action (3,), or None at the end; "ee_position" is read."""
        return self._route.next(
            np.asarray(obs["ee_position"], np.float64), self._target, self._others
        )


class _Plans:
    """How n pushes will go, by arrays of all: `starts`, `flies`, `approach` and `length`."""

    def __init__(
        self, waypoints: Floats, counts: Array, way: Approaches, full_steps: bool, ee: Floats
    ) -> None:
        """Plan pushes along waypoints (N, 3), of which each has its count, in full steps or not.

        Args:
            waypoints: Of all of them.
            counts: How many each has (n,).
            way: To their starts.
            full_steps: Whether actions cut corners.
            ee: End effector (3,) [m].
        """
        first = np.cumsum(counts) - counts
        starts = self.starts = waypoints[first]
        self.flies = way.flies
        here = np.broadcast_to(ee, starts.shape)
        corners = np.concatenate([here[:, None], way.corners, starts[:, None]], axis=1)
        there = np.linalg.norm(np.diff(corners, axis=1), axis=-1)
        legs = np.zeros(len(waypoints))
        legs[1:] = np.linalg.norm(np.diff(waypoints, axis=0), axis=-1)
        # From one push to the next there is no leg.
        legs[first] = 0
        if full_steps:
            self.approach = _actions(there.sum(axis=1))
            self.length = _actions(_sums(legs, first))
        else:
            self.approach = _actions(there).sum(axis=1)
            self.length = _sums(_actions(legs), first)


def _sums(row: Floats, first: Array) -> Floats:
    """Return the sums of the parts of a row that begin at `first`."""
    sums: Floats = np.add.reduceat(row, first) if len(first) else row
    return sums


def _actions(lengths: Floats) -> Floats:
    """Return how many actions lengths [m] take; their end counts as reached from nearby."""
    actions: Floats = np.ceil(np.maximum(lengths - _SEEN.tolerance, 0) / ACTION_LENGTH)
    return actions


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
    """Return how pushes look, of which all or none are in full steps.

    Raises:
        MechSearchError: If no part of the target is visible.
    """
    centre = sight.centre
    if centre is None:
        raise MechSearchError(_UNSEEN)
    frames = _Frames(pushes, centre)
    counts, own, way = _paths(pushes, frames)
    heights = np.repeat([push.height for push in pushes], counts)
    waypoints = waypoints_along(way, centre, heights, _SEEN)
    config = replace(_SEEN, full_steps=any(push.full_steps for push in pushes))
    starts = waypoints[np.cumsum(counts) - counts]
    approach = approaches(starts, sight.ee_position, centre, sight.obstacles, config)
    plans = _Plans(waypoints, counts, approach, config.full_steps, sight.ee_position)
    return PushViews(
        _patches(frames, np.split(own, np.cumsum(counts)), plans.starts[:, 2], sight),
        _numbers(pushes, frames, plans, sight),
        (plans.approach + plans.length).astype(np.float32),
    )


class _Frames:
    """The axes, places, middles (n, 2) and directions of n pushes; axes as `Push` has them of one.

    A middle is the point that a push passes. The side (n,) of the second axis is 1 on the left, and
    -1 on the right.
    """

    def __init__(self, pushes: Sequence[Push], centre: Floats) -> None:
        directions = self.directions = np.array([push.direction for push in pushes])
        lateral = np.array([push.lateral for push in pushes])
        self.side = np.array([-1.0 if push.mirrored else 1.0 for push in pushes])
        self.along = np.stack([np.cos(directions), np.sin(directions)], axis=-1)
        left = np.stack([-self.along[:, 1], self.along[:, 0]], axis=-1)
        self.across = self.side[:, None] * left
        self.places = centre[:2] + np.array([push.offset for push in pushes]).reshape(-1, 2)
        self.middles = self.places + lateral[:, None] * left


def _paths(pushes: Sequence[Push], frames: _Frames) -> tuple[NDArray[np.intp], Floats, Floats]:
    """Return how many waypoints each push has, and all (N, 2) in own axes and in the world's."""
    spirals = np.array([push.kind == "spiral" for push in pushes], np.bool_)
    turns, before, after = (
        np.array([getattr(push, name) for push in pushes]) for name in ("turns", "before", "after")
    )
    points = np.maximum(np.rint(turns / SPIRAL_TURNS * SPIRAL_POINTS), 3)
    counts = np.where(spirals, points, 2).astype(np.intp)
    owner, ends = np.repeat(np.arange(len(pushes)), counts), np.cumsum(counts)
    number = np.arange(len(owner)) - (ends - counts)[owner]
    turned = number * (turns / (counts - 1))[owner]
    turned[ends - 1] = turns
    away = np.where(
        spirals[owner],
        INNER + (OUTER - INNER) / SPIRAL_TURNS * turned,
        np.where(number == 0, -before[owner], after[owner]),
    )[:, None]
    angles = 2 * np.pi * turned
    own = away * np.stack([np.cos(angles), np.sin(angles)], axis=-1) + 0.0
    angles = frames.directions[owner] + frames.side[owner] * angles
    way = away * np.stack([np.cos(angles), np.sin(angles)], axis=-1) + frames.middles[owner]
    return counts, own, way


_BLOCK = 8
"""Patches drawn at a time: what is computed of them stays in a processor's cache."""


def _patches(
    frames: _Frames, ways: Sequence[Floats], heights: Floats, sight: Sight
) -> NDArray[np.float16]:
    assert sight.centre is not None
    patches = np.zeros((len(heights), *PATCH), np.float16)
    level = max(sight.centre[2], 0.02)
    heap, target = np.pad([sight.heights, sight.target], ((0, 0), (1, 1), (1, 1)))
    # Between pixels of it, or beside one.
    width = heap.shape[1]
    about = np.flatnonzero(target)[:, None] - [0, 1, width, width + 1]
    shows = np.zeros(target.size, np.bool_)
    shows[about] = True
    for first in range(0, len(heights), _BLOCK):
        some = slice(first, first + _BLOCK)
        x, y = (
            frames.middles[some, i, None, None]
            + _STEPS * frames.along[some, i, None, None]
            + _STEPS[:, None] * frames.across[some, i, None, None]
            for i in range(2)
        )
        column, row = sight.camera.project_level(x, y, level)
        place, shares = _between(heap.shape, row, column)
        height = _sample(heap, place, shares)
        patches[some, 0] = 10 * height
        patches[some, 1] = 10 * (height - heights[some, None, None])
        seen = shows.take(place).nonzero()
        patches[some, 2][seen] = _sample(target, place[seen], [share[seen] for share in shares])
        _draw_paths(ways[some], patches[some, 3])
    return patches


_STEPS = (np.arange(PATCH[1]) - (PATCH[1] - 1) / 2) * CELL


def _draw_paths(ways: Sequence[Floats], images: NDArray[np.float16]) -> None:
    """Draw paths in their pushes' own frames (n, 32, 32): 1 on them, falling to 0 beside them."""
    points = np.concatenate([np.zeros((1, 2)), *ways])
    pushed = np.repeat(np.arange(len(ways)), [len(way) for way in ways])
    inner = np.append(pushed[1:] == pushed[:-1], False)[: len(pushed)]
    starts, owner = points[1:][inner], pushed[inner]
    legs = points[2:][inner[:-1]] - starts
    # Most pixels are beside no leg.
    low = np.minimum(legs, 0) + starts - _WIDTH
    high = np.maximum(legs, 0) + starts + _WIDTH
    near = (low[..., None] < _STEPS) & (high[..., None] > _STEPS)
    both = near[:, 1, :, None] & near[:, 0, None, :]
    # Several times as fast as `nonzero`.
    leg, row, column = np.unravel_index(np.flatnonzero(both), both.shape)
    x, y, dx, dy = (one.take(leg) for one in (*starts.T.copy(), *legs.T.copy()))
    u, v = _STEPS[column] - x, _STEPS[row] - y
    along = np.clip((u * dx + v * dy) / (dx * dx + dy * dy), 0, 1)
    u -= along * dx
    v -= along * dy
    nearest = np.full(len(ways) * PATCH[1] * PATCH[2], _WIDTH**2)
    pixel = (owner[leg] * PATCH[1] + row) * PATCH[2] + column
    np.minimum.at(nearest, pixel, u * u + v * v)
    drawn = np.flatnonzero(nearest < _WIDTH**2)
    shade = np.maximum(1 - np.sqrt(nearest[drawn]) / _WIDTH, 0)
    images[np.unravel_index(drawn, images.shape)] = shade


def _between(
    shape: tuple[int, ...], rows: Floats, columns: Floats
) -> tuple[NDArray[np.intp], list[Floats]]:
    """Return where places (...,) lie between an image's pixels; see `_sample`.

    Args:
        shape: Of the image in a frame, one pixel wide (H + 2, W + 2).
        rows: Of the places in the image [px].
        columns: Likewise.

    Returns:
        The flat index of the pixel above on the left, and the shares of up, down, left and right.
    """
    height, width = shape
    rows = np.clip(rows + 1, 0, height - 1.001)
    columns = np.clip(columns + 1, 0, width - 1.001)
    row, column = rows.astype(np.intp), columns.astype(np.intp)
    down, right = rows - row, columns - column
    up, left = 1 - down, 1 - right
    return row * width + column, [up, down, left, right]


def _sample(framed: Floats, place: NDArray[np.intp], shares: Sequence[Floats]) -> Floats:
    """Return an image in a frame of zeros (H + 2, W + 2) between its pixels; see `_between`."""
    up, down, left, right = shares
    flat, width = framed.ravel(), framed.shape[1]
    upper = flat.take(place) * left + flat[1:].take(place) * right
    lower = flat[width:].take(place) * left + flat[width + 1 :].take(place) * right
    return upper * up + lower * down


def _numbers(
    pushes: Sequence[Push], frames: _Frames, plans: _Plans, sight: Sight
) -> NDArray[np.float32]:
    assert sight.centre is not None
    n, tip, ee = len(pushes), plans.starts[:, 2], sight.ee_position
    away = ee[:2] - frames.middles
    columns = [
        20 * ((frames.middles - frames.places) * frames.across).sum(axis=1),
        np.array([8 * push.before for push in pushes]),
        np.array([8 * push.after for push in pushes]),
        np.array([push.turns for push in pushes]),
        10 * tip,
        20 * (tip - sight.centre[2]),
        np.full(n, 10 * sight.centre[2]),
        np.full(n, float(sight.target.mean()) * 100),
        np.array([float(push.kind == KINDS[0]) for push in pushes]),
        plans.approach / 10,
        plans.length / 10,
        4 * (away * frames.along).sum(axis=1),
        4 * (away * frames.across).sum(axis=1),
        5 * (ee[2] - tip),
        plans.flies,
    ]
    return np.stack(columns, axis=1).astype(np.float32).reshape(n, NUMBERS)
