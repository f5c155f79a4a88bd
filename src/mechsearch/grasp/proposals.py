"""Grasps proposed by geometry alone, in a depth image (the paper's jaws) and for any gripper."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mechsearch.grasp.grasp_view import ANGLES, GraspView, HeightMap, ImageGrasp, bin_angle
from mechsearch.sim import Gripper
from mechsearch.types import Array, Floats

_EACH = 128
"""Random grasps from which each geometric one is picked, on average at most."""

_BESIDE = (-1.0, 0.0, 1.0)
"""Lines along which a finger's way is checked, in half its widths."""


@dataclass(frozen=True, eq=False)
class _Batch:
    """Grasps as arrays (K,); see `ImageGrasp`."""

    row: Floats
    column: Floats
    depth: Floats
    angle: Array

    def where(self, keep: Array) -> "_Batch":
        return _Batch(self.row[keep], self.column[keep], self.depth[keep], self.angle[keep])

    def grasps(self) -> list[ImageGrasp]:
        turns = bin_angle(self.angle)
        values = zip(self.row, self.column, self.depth, turns, strict=True)
        return [ImageGrasp(*(float(value) for value in grasp)) for grasp in values]


def uniform(view: GraspView, rng: np.random.Generator, count: int) -> list[ImageGrasp]:
    """Return grasps drawn uniformly from the policy's own angles and depths on visible pixels."""
    return _drawn(view, rng, count).grasps()


def antipodal(
    view: GraspView, rng: np.random.Generator, count: int, gripper: Gripper
) -> list[ImageGrasp]:
    """Return grasps whose fingers go down freely on both sides of the visible target.

    Uniform grasps are moved to the middle of what lies between their fingers, and kept if that is
    the target alone, reaches between the fingers, and leaves room for both.

    Returns:
        At most `count` grasps; fewer where the depth image offers hardly any.
    """
    drawn = _drawn(view, rng, _EACH * count)
    centred, held = _moved(view, drawn, gripper)
    free = held & _fingers_free(view, centred, gripper)
    return centred.where(np.flatnonzero(free)[:count]).grasps()


def _drawn(view: GraspView, rng: np.random.Generator, count: int) -> _Batch:
    rows, columns = np.nonzero(view.mask)
    pixel = rng.integers(len(rows), size=count)
    depths = view.gripper_depths
    return _Batch(
        rows[pixel].astype(np.float64),
        columns[pixel].astype(np.float64),
        depths[rng.integers(len(depths), size=count)],
        rng.integers(ANGLES, size=count),
    )


def _moved(view: GraspView, batch: _Batch, gripper: Gripper) -> tuple[_Batch, Array]:
    """Return grasps moved to the middle of what is between their fingers, and which hold it."""
    start, end, held = _between(view, batch, gripper, 0.0)
    shift = np.where(held, (start + end) / 2, 0.0)
    *one, one_held = _between(view, batch, gripper, -gripper.width / 4)
    *other, other_held = _between(view, batch, gripper, gripper.width / 4)
    # Both outlines must face the fingers within the friction cone, or it slides out sideways.
    slope = np.abs(np.subtract(one, other)).max(axis=0) / (gripper.width / 2)
    held = held & one_held & other_held & (slope <= gripper.friction)
    to_right, down = _steps(view, batch)
    rows, columns = np.rint(batch.row + shift * down), np.rint(batch.column + shift * to_right)
    return _Batch(rows, columns, batch.depth, batch.angle), held


def _between(
    view: GraspView, batch: _Batch, gripper: Gripper, across: float
) -> tuple[Floats, Floats, Array]:
    """Return where (K,) what is between the fingers starts and ends [m], and if it is the target.

    Only what rises at least 5 mm above the grasp centre counts as held.
    """
    along = np.linspace(-gripper.opening / 2, gripper.opening / 2, 57)
    depth, on_target = _profile(view, batch, along, across)
    between = depth < batch.depth[:, None]
    held = (depth < batch.depth[:, None] - 0.005).any(axis=1)
    first = np.argmax(between, axis=1)
    last = len(along) - 1 - np.argmax(between[:, ::-1], axis=1)
    alone = np.asarray((on_target | ~between).all(axis=1))
    return along[first], along[last], np.asarray(held & alone)


def _fingers_free(view: GraspView, batch: _Batch, gripper: Gripper) -> NDArray[np.bool_]:
    """Return which grasps (K,) have room for both fingers down to their tips."""
    tip = np.minimum(batch.depth + gripper.reach, view.far - gripper.clearance)
    inner, outer = gripper.opening / 2, gripper.opening / 2 + gripper.thickness
    finger = np.linspace(inner, outer, 5)
    along = np.concatenate([-finger, finger])
    free = np.ones(len(tip), np.bool_)
    for across in _BESIDE:
        depth, _ = _profile(view, batch, along, across * gripper.width / 2)
        free &= (depth > tip[:, None]).all(axis=1)
    return free


def _profile(
    view: GraspView, batch: _Batch, along: Floats, across: float
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return depths (K, S) [m] on a line beside each grasp, and which are the target's.

    Args:
        view: The image; beyond its border is what things stand on.
        batch: K grasps.
        along: Places on the closing direction (S,) [m].
        across: Distance of the line from the grasp centre [m].
    """
    right, down = _steps(view, batch)
    rows = np.rint(batch.row[:, None] + down[:, None] * along + right[:, None] * across)
    columns = np.rint(batch.column[:, None] + right[:, None] * along - down[:, None] * across)
    height, width = view.depth.shape
    inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    i, j = np.where(inside, rows, 0).astype(int), np.where(inside, columns, 0).astype(int)
    return np.where(inside, view.depth[i, j], view.far), inside & view.mask[i, j]


def _steps(view: GraspView, batch: _Batch) -> tuple[Floats, Floats]:
    """Return how far right and down (K,) [px] a metre along the closing direction leads."""
    angle = bin_angle(batch.angle)
    scale = view.camera.fx / batch.depth
    return np.cos(angle) * scale, np.sin(angle) * scale


_LINES = 3000
"""Lines through the target that are tried."""

_CLOSER = 300
"""Of those between whose ends the target is free, and of all others: looked at more closely."""

_ACROSS = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
"""Lines along which a finger's way is checked, in half its widths."""

_SPARE = 0.002
"""Room between a finger's tip and what lies under it, and beside the target [m]."""

_ENGAGED = 0.006
"""Least height of the target above the tips [m]."""

_FOREIGN = 0.05
"""Share of what is between free jaws that need not be seen as the target: an outline's cells."""

_APART, _TURNS = 0.004, 16
"""Of grasps in one cube of this side [m] and one of so many bins of direction, one is kept."""


def propose_jaws(
    heights: HeightMap,
    rng: np.random.Generator,
    count: int,
    gripper: Gripper,
    others: float = 0.4,
) -> Floats:
    """Return grasps (K, 7) from above that close across the visible part of the target.

    Lines through visible points of the target are cut where the target ends, and the jaws centred
    between both ends. Most proposals are free: the fingers go down beside the target, as deep as
    what lies under them allows or less, and close on the target alone, on outlines that face them.
    Where clutter leaves no such place, fingers must push it aside: the others ignore what they
    meet but the target, those first that have little of it between them. No two are alike.

    Args:
        heights: Around the target.
        rng: Draws lines and depths.
        count: Of grasps, at most.
        gripper: The jaws.
        others: Share of proposals that are not free, where there are as many; they take the place
            of missing free ones too, unless it is 0.

    Returns:
        Poses of the gripper's frame, in random order; fewer or none on what is wide or low.
    """
    jaws = _centred(heights, rng, gripper)
    which, tip, foreign, free = _at_depths(heights, jaws, gripper)
    # Free ones at random, then the others, roughly by what is in their way.
    order = np.argsort(np.where(free, -1.0, foreign) + rng.uniform(0.0, 0.5, len(free)))
    which, tip, free = which[order], tip[order], free[order]
    yaw = jaws.angle[which]
    poses = np.zeros((len(tip), 7))
    poses[:, :2], poses[:, 2] = jaws.centre[which], tip + gripper.reach
    poses[:, 3], poses[:, 6] = np.cos(yaw / 2), np.sin(yaw / 2)
    # Closing directions are alike modulo a half turn.
    bins = np.rint(yaw / (np.pi / _TURNS)) % _TURNS
    kinds = np.column_stack([np.rint(poses[:, :3] / _APART), bins])
    first = np.sort(np.unique(kinds, axis=0, return_index=True)[1])
    some, rest = first[free[first]], first[~free[first]]
    rest = rest[: max(count - len(some), round(others * count)) if others else 0]
    chosen = np.concatenate([some[: count - len(rest)], rest])
    return np.asarray(poses[rng.permutation(chosen)])


@dataclass(frozen=True, eq=False)
class _Jaws:
    """Jaws (K,) centred on the target: place (K, 2), closing direction, height of the tips."""

    centre: Floats
    angle: Floats
    tip: Floats


def _centred(heights: HeightMap, rng: np.random.Generator, gripper: Gripper) -> _Jaws:
    """Return jaws between whose fingers random parts of the target fit."""
    own = np.flatnonzero(heights.target)
    own = own[rng.integers(len(own), size=_LINES)]
    place, angle = heights.place(own), rng.uniform(0.0, np.pi, _LINES)
    lowest = gripper.clearance
    deep = np.maximum(heights.height.ravel()[own] - _ENGAGED - lowest, 0.0)
    tip = lowest + rng.random(_LINES) ** 2 * deep
    count = int(np.ceil(gripper.opening / heights.cell))
    steps = heights.cell * np.arange(-count, count + 1, dtype=np.float64)
    cells = _cells(heights, place, angle, steps, np.zeros(1))[:, 0]
    above = heights.height.ravel()[cells] > tip[:, None] + _SPARE / 2
    target = above & heights.target.ravel()[cells]
    # What goes on to the end of the line is too wide whatever follows.
    after = np.argmin(target[:, count:], axis=1)
    before = np.argmin(target[:, count::-1], axis=1)
    width = (after + before - 1) * heights.cell
    fits = (after > 0) & (before > 0) & (width <= gripper.opening - 2 * _SPARE)
    row = np.arange(_LINES)
    ends = above[row, count + after] | above[row, count - before]
    kept = np.concatenate([np.flatnonzero(fits & ~ends)[:_CLOSER],
                           np.flatnonzero(fits & ends)[:_CLOSER]])  # fmt: skip
    shift = (after - before)[kept, None] / 2 * heights.cell
    angle = angle[kept]
    axis = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return _Jaws(place[kept] + shift * axis, angle, tip[kept])


def _at_depths(
    heights: HeightMap, jaws: _Jaws, gripper: Gripper
) -> tuple[Array, Floats, Floats, NDArray[np.bool_]]:
    """Return jaws at several depths: which, height of the tips, what else they hold, if free.

    What else they hold is its share of what is between the fingers.
    """
    half = gripper.opening / 2
    count = int(np.ceil(gripper.opening / heights.cell))
    inner = np.linspace(-half, half, count + 1)
    finger = half + np.linspace(0.0, gripper.thickness, 5)
    finger = np.concatenate([-finger, finger])
    across = _ACROSS * gripper.width / 2
    cells = _cells(heights, jaws.centre, jaws.angle, finger, across)
    height = heights.height.ravel()[cells]
    under = height.max(axis=(1, 2))
    own = np.where(heights.target.ravel()[cells], height, 0.0).max(axis=(1, 2))
    cells = _cells(heights, jaws.centre, jaws.angle, inner, across)
    between, target = heights.height.ravel()[cells], heights.target.ravel()[cells]
    top = np.where(target, between, 0.0).max(axis=(1, 2))
    # The palm must stay above what is between the fingers.
    floor = np.maximum(between.max(axis=(1, 2)) - gripper.length + 2 * _SPARE, gripper.clearance)
    room = np.maximum(under + _SPARE, floor)
    tips = [low + part * (jaws.tip - low) for low, part in
            ((room, 0.0), (room, 0.5), (room, 1.0), (floor, 0.3))]  # fmt: skip
    tip, which = np.concatenate(tips), np.tile(np.arange(len(room)), len(tips))
    kept = np.flatnonzero((tip >= np.maximum(floor, own)[which]) & (top[which] - tip >= _ENGAGED))
    tip, which = tip[kept], which[kept]
    above = between[which] > tip[:, None, None]
    filled = np.maximum(above.sum(axis=(1, 2)), 1)
    foreign = (above & ~target[which]).sum(axis=(1, 2)) / filled
    # Both outlines must face the fingers within the friction cone, or it slides out sideways.
    pads = above[:, [1, 3]]
    first, last = np.argmax(pads, axis=2), np.argmax(pads[:, :, ::-1], axis=2)
    slant = np.maximum(np.abs(np.diff(first, axis=1)), np.abs(np.diff(last, axis=1)))[:, 0]
    facing = slant * (inner[1] - inner[0]) / (gripper.width / 2) <= 1.2 * gripper.friction
    facing &= pads.any(axis=-1).all(axis=-1)
    alone = foreign <= _FOREIGN
    free = (tip >= room[which]) & alone
    # Where something else is between the fingers, the outline may be where it hides the target.
    kept = np.flatnonzero(facing | ~alone)
    return which[kept], tip[kept], foreign[kept], free[kept]


def _cells(
    heights: HeightMap, centre: Floats, angle: Floats, along: Floats, across: Floats
) -> NDArray[np.intp]:
    """Return flat indices (K, A, S) of the cells on lines beside K places."""
    cos, sin = np.cos(angle)[:, None, None], np.sin(angle)[:, None, None]
    u, v = along, across[:, None]
    x = centre[:, 0, None, None] + cos * u - sin * v
    y = centre[:, 1, None, None] + sin * u + cos * v
    return heights.cells(x, y)


_PLACES = 1000
"""Visible places of the target that are tried."""

_ROUGH = 0.0025
"""Largest distance of the surface under the lip from its own plane [m]."""

_STEEPEST = np.deg2rad(45.0)
"""Greatest tilt of the approach [rad]."""


def propose_suction(
    heights: HeightMap, rng: np.random.Generator, count: int, radius: float
) -> Floats:
    """Return grasps (K, 7) where the cup's whole lip is on the visible target and nearly flat.

    Args:
        heights: Around the target.
        rng: Draws places.
        count: Of grasps, at most.
        radius: Of the lip [m].

    Returns:
        Poses of the gripper's frame in random order: the point that the lip touches, z axis along
        the normal of the plane through the surface under it; fewer or none where nothing is flat.
    """
    own = np.flatnonzero(heights.target)
    own = own[rng.permutation(len(own))[:_PLACES]]
    reach = int(np.ceil(radius / heights.cell))
    u, v = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    lip = u**2 + v**2 <= (radius / heights.cell + 0.25) ** 2
    u, v = u[lip], v[lip]
    # No cell under a lip is beyond the map: its margin is wider.
    cells = own[:, None] + u * heights.height.shape[1] + v
    whole = heights.target.ravel()[cells].all(axis=1)
    own, cells = own[whole], cells[whole]
    height = heights.height.ravel()[cells].astype(np.float64)
    middle = height.mean(axis=1)
    offset = height - middle[:, None]
    squares = float((u**2).sum()) * heights.cell
    slope = np.stack([offset @ u, offset @ v], axis=1) / squares
    plane = (slope[:, :1] * u + slope[:, 1:] * v) * heights.cell
    upright = 1.0 / np.sqrt(1.0 + (slope**2).sum(axis=1))
    rough = np.abs(offset - plane).max(axis=1, initial=0.0) * upright
    good = np.flatnonzero((rough <= _ROUGH) & (upright >= np.cos(_STEEPEST)))[:count]
    # The shortest turn that brings the z axis to the normal.
    normal = np.column_stack([-slope, np.ones(len(slope))])[good] * upright[good, None]
    turn = np.column_stack([1.0 + normal[:, 2], -normal[:, 1], normal[:, 0], np.zeros(len(good))])
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    return np.column_stack([heights.place(own[good]), middle[good], turn])
