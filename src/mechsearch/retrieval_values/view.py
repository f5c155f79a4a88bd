"""How pushes and removals look: patches of the height map about the target, and numbers."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mechsearch.grippers import HeightMap
from mechsearch.pushes.push import PlannedPush, Push, Sight
from mechsearch.retrieval.grasper import Candidate
from mechsearch.types import Array, Floats

OPTION_PATCH = (5, 40, 40)
"""Channels, rows and columns of a patch about the middle of the target's visible part. Along a row
a push goes forward, or the removed object lies; the channels are the height over the table in
decimetres, the visible target, the best chance of the grasps in each cell, the path or what is
removed, and how far all rises over the fingertip, in decimetres, 0 for removals."""

_CELL = 0.006
"""Side of a patch's cell [m]."""

OPTION_NUMBERS = 13
"""How many numbers describe a decision beside its patch."""

MIRRORED_OPTION_NUMBERS = (8,)
"""Which of them change their sign where left and right are exchanged."""

_BESIDE = 0.02
"""Distance from a push's path at which it is no longer drawn [m]."""


@dataclass(frozen=True, eq=False)
class PushOption:
    """A push that could be made.

    Attributes:
        push: Its shape and place.
        sight: Where it is planned.
        planned: The way, at its beginning; it is not carried out.
    """

    push: Push
    sight: Sight
    planned: PlannedPush

    @classmethod
    def plan(cls, push: Push, sight: Sight) -> "PushOption":
        """Return a push where the target is seen."""
        return cls(push, sight, PlannedPush(push, sight))

    def begun(self) -> PlannedPush:
        """Return the way, to be carried out."""
        return PlannedPush(self.push, self.sight)

    @property
    def actions(self) -> float:
        """How many actions it takes, as planned."""
        return self.planned.approach + self.planned.length


@dataclass(frozen=True, eq=False)
class RemovalOption:
    """An object that could be put aside.

    Attributes:
        grasp: How it would be grasped.
        place: Points of its visible part (P, 2) [m].
        height: The greatest of them [m].
        occludes: Whether it seems to lie on the target.
    """

    grasp: Candidate
    place: Floats
    height: float
    occludes: bool

    @property
    def actions(self) -> float:
        """Push actions that it takes: none."""
        return 0.0


Option = PushOption | RemovalOption


@dataclass(frozen=True, eq=False)
class Situation:
    """What decisions are made from.

    Attributes:
        heights: The map around the visible target.
        middle: Of the target's visible part (2,) [m].
        grasps: Grasps of the target, the best first.
    """

    heights: HeightMap
    middle: Floats
    grasps: Sequence[Candidate]

    @property
    def chance(self) -> float:
        """Of the best grasp; 0 without one."""
        return self.grasps[0].quality if self.grasps else 0.0


@dataclass(frozen=True, eq=False)
class OptionViews:
    """How n options look in one situation.

    Attributes:
        patches: (n, *OPTION_PATCH) float16.
        numbers: (n, OPTION_NUMBERS) float32.
    """

    patches: NDArray[np.float16]
    numbers: NDArray[np.float32]


NO_OPTIONS = OptionViews(
    np.zeros((0, *OPTION_PATCH), np.float16), np.zeros((0, OPTION_NUMBERS), np.float32)
)
"""How nothing looks."""


def view_options(options: Sequence[Option], situation: Situation) -> OptionViews:
    """Return how options look."""
    along = np.array([_along(option, situation) for option in options]).reshape(-1, 2)
    patches = np.zeros((len(options), *OPTION_PATCH), np.float16)
    if len(options):
        _fill(patches, options, along, situation)
    numbers = np.array([_numbers(option, situation) for option in options], np.float32)
    return OptionViews(patches, numbers.reshape(-1, OPTION_NUMBERS))


def _fill(
    patches: NDArray[np.float16], options: Sequence[Option], along: Floats, situation: Situation
) -> None:
    heights, middle = situation.heights, situation.middle
    left = np.stack([-along[:, 1], along[:, 0]], axis=1)
    steps = (np.arange(OPTION_PATCH[2]) - (OPTION_PATCH[2] - 1) / 2) * _CELL
    v, u = np.meshgrid(steps, steps, indexing="ij")
    places = middle + u[..., None] * along[:, None, None] + v[..., None] * left[:, None, None]
    cells = heights.cells(places[..., 0], places[..., 1])
    height = heights.height.ravel()[cells]
    patches[:, 0], patches[:, 1] = 10 * height, heights.target.ravel()[cells]
    patches[:, 2] = _chances(situation.grasps, along, left, middle)
    for i, option in enumerate(options):
        if isinstance(option, PushOption):
            patches[i, 3] = _path(option.planned.path, places[i])
            patches[i, 4] = 10 * (height[i] - option.planned.start[2])
        else:
            own = _cells_of(option.place - middle, along[i], left[i])
            patches[i, 3].reshape(-1)[own] = 1.0


def _chances(grasps: Sequence[Candidate], along: Floats, left: Floats, middle: Floats) -> Floats:
    """Return the best chance of the grasps in each cell (n, 40, 40)."""
    chances = np.zeros((len(along), OPTION_PATCH[1] * OPTION_PATCH[2]))
    if grasps:
        places = np.array([g.pose[:2] for g in grasps]) - middle
        quality = np.array([g.quality for g in grasps])
        for i in range(len(along)):
            np.maximum.at(chances[i], _cells_of(places, along[i], left[i]), quality)
    return chances.reshape(-1, *OPTION_PATCH[1:])


def _cells_of(offsets: Floats, along: Floats, left: Floats) -> Array:
    """Return flat indices of the patch's cells that points (P, 2) off its middle are in."""
    size = OPTION_PATCH[2]
    column = np.clip(np.rint(offsets @ along / _CELL + (size - 1) / 2), 0, size - 1)
    row = np.clip(np.rint(offsets @ left / _CELL + (size - 1) / 2), 0, size - 1)
    return np.asarray((row * size + column).astype(np.intp))


def _path(way: Floats, places: Floats) -> Floats:
    """Return 1 on a way (N, 2), falling to 0 beside it, at places (R, C, 2)."""
    start, step = way[:-1], np.diff(way, axis=0)
    length = np.maximum((step * step).sum(axis=1), 1e-12)
    off = places[..., None, :] - start
    share = np.clip((off * step).sum(axis=-1) / length, 0, 1)
    away = np.linalg.norm(off - share[..., None] * step, axis=-1).min(axis=-1)
    return np.asarray(np.maximum(1 - away / _BESIDE, 0))


def _along(option: Option, situation: Situation) -> Floats:
    """Return the direction (2,) of a patch's rows."""
    if isinstance(option, PushOption):
        return np.asarray(option.push.axes[0])
    away = option.place.mean(axis=0) - situation.middle
    length = float(np.linalg.norm(away))
    return away / length if length > 1e-6 else np.array([1.0, 0.0])


def _numbers(option: Option, situation: Situation) -> list[float]:
    heights, best = situation.heights, situation.chance
    visible = heights.cell * float(np.sqrt(heights.target.sum()))
    # A target of few pixels may be in no cell.
    top = float(heights.height[heights.target].max(initial=0.0))
    shared = [2 * best, 20 * visible, 10 * top, float(len(situation.grasps)) / 50]
    if isinstance(option, RemovalOption):
        away = float(np.linalg.norm(option.place.mean(axis=0) - situation.middle))
        own = [2 * option.grasp.quality, 10 * option.height, 10 * away]
        return [*shared, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, *own]
    push, planned = option.push, option.planned
    straight = float(push.kind == "straight")
    return [
        *shared, 1.0, straight, 8 * push.before, 8 * push.after, 20 * push.lateral,
        10 * float(planned.start[2]), push.turns, planned.length / 10, planned.approach / 10,
    ]  # fmt: skip
