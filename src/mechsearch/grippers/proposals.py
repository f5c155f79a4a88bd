"""Grasps proposed by geometry alone, on a height map."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mechsearch.grippers.grasp_view import HeightMap
from mechsearch.grippers.gripper import AnyGripper, Gripper
from mechsearch.types import Array, Floats

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


def propose(
    heights: HeightMap, rng: np.random.Generator, count: int, gripper: AnyGripper
) -> Floats:
    """Return at most `count` grasps (K, 7) of a gripper that geometry promises, in random order."""
    if not heights.target.any():
        return np.empty((0, 7))
    if isinstance(gripper, Gripper):
        return propose_jaws(heights, rng, count, gripper)
    return propose_suction(heights, rng, count, gripper.radius)
