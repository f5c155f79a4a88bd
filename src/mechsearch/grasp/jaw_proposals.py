"""Grasps for parallel jaws of any opening, proposed by geometry alone."""

import numpy as np
from numpy.typing import NDArray

from mechsearch.grasp.height_map import HeightMap
from mechsearch.sim.gripper import Gripper
from mechsearch.types import Array, Floats

_LINES = 1500
"""Lines through the target that are tried."""

_REFINED = 400
"""Of those that the target's outline promises, how many are looked at closely."""

_ACROSS = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
"""Lines along which a finger's way is checked, in half its widths."""

_SPARE = 0.002
"""Room between a finger's tip and what lies under it, and beside the target [m]."""

_ENGAGED = 0.006
"""Least height of the target above the tips [m]."""

_FOREIGN = 0.05
"""Share of what is between the fingers that need not be seen as the target: an outline's cells."""


def propose_jaws(
    heights: HeightMap, rng: np.random.Generator, count: int, gripper: Gripper
) -> Floats:
    """Return grasps (K, 7) from above whose fingers go down freely on both sides of the target.

    Lines through visible points of the target are cut where its outline ends; the jaws are centred
    between both ends, and go as deep as what lies under them allows, or less deep. Kept is what
    closes on the target alone, on outlines that face the fingers. No two grasps are alike.

    Args:
        heights: Around the target.
        rng: Draws lines and depths.
        count: Of grasps, at most.
        gripper: The jaws.

    Returns:
        Poses of the gripper's frame, in random order; fewer or none where there is little room.
    """
    own = np.flatnonzero(heights.target)
    place = heights.place(own[rng.integers(len(own), size=_LINES)])
    angle = rng.uniform(0.0, np.pi, _LINES)
    share = rng.random(_LINES) ** 2
    centre, tip, fits = _centred(heights, place, angle, share, gripper)
    kept = np.flatnonzero(fits)[:_REFINED]
    return _refined(heights, rng, centre[kept], angle[kept], tip[kept], count, gripper)


def _centred(
    heights: HeightMap, place: Floats, angle: Floats, share: Floats, gripper: Gripper
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return middles (K, 2) of the target's outline on lines, tip heights, and which fit."""
    count = int(np.ceil(gripper.opening / heights.cell))
    along = np.arange(-count, count + 1) * heights.cell
    cells = _cells(heights, place, angle, along, np.zeros(1))[:, 0]
    height, target = heights.height.ravel()[cells], heights.target.ravel()[cells]
    lowest = gripper.clearance
    tip = lowest + share * np.maximum(height[:, count] - _ENGAGED - lowest, 0.0)
    above = height > tip[:, None] + _SPARE / 2
    # An outline that goes on beyond the line is too wide whatever follows.
    after = np.argmin(above[:, count:], axis=1)
    before = np.argmin(above[:, count::-1], axis=1)
    width = (after + before - 1) * heights.cell
    fits = (after > 0) & (before > 0) & (width <= gripper.opening - 2 * _SPARE)
    steps = np.arange(-count, count + 1)
    run = (steps < after[:, None]) & (steps > -before[:, None])
    fits &= (run & ~target).sum(axis=1) <= _FOREIGN * (after + before - 1)
    shift = (after - before) / 2 * heights.cell
    axis = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return place + shift[:, None] * axis, tip, fits


def _refined(
    heights: HeightMap,
    rng: np.random.Generator,
    centre: Floats,
    angle: Floats,
    tip: Floats,
    count: int,
    gripper: Gripper,
) -> Floats:
    """Return the grasps at up to three depths for each of some centred jaws."""
    half = gripper.opening / 2
    number = int(np.ceil(gripper.opening / heights.cell))
    inner = np.linspace(-half, half, number + 1)
    finger = half + np.linspace(0.0, gripper.thickness, 5)
    across = _ACROSS * gripper.width / 2
    under = heights.height.ravel()[
        _cells(heights, centre, angle, np.concatenate([-finger, finger]), across)
    ]
    cells = _cells(heights, centre, angle, inner, across)
    between, target = heights.height.ravel()[cells], heights.target.ravel()[cells]
    top = between.max(axis=(1, 2))
    room = np.maximum(under.max(axis=(1, 2)) + _SPARE, gripper.clearance)
    # The palm must stay above what is between the fingers.
    deepest = np.maximum(room, top - gripper.length + 2 * _SPARE)
    tips = np.concatenate([deepest + part * (tip - deepest) for part in (0.0, 0.5, 1.0)])
    which = np.tile(np.arange(len(centre)), 3)
    kept = np.flatnonzero((tips >= deepest[which]) & (top[which] - tips >= _ENGAGED))
    tips, which = tips[kept], which[kept]
    above = between[which] > tips[:, None, None]
    foreign = (above & ~target[which]).sum(axis=(1, 2))
    alone = foreign <= _FOREIGN * above.sum(axis=(1, 2))
    # Both outlines must face the fingers within the friction cone, or it slides out sideways.
    pads = above[:, [1, 3]]
    first, last = np.argmax(pads, axis=2), np.argmax(pads[:, :, ::-1], axis=2)
    slant = np.maximum(np.abs(np.diff(first, axis=1)), np.abs(np.diff(last, axis=1)))[:, 0]
    slope = slant * (inner[1] - inner[0]) / (gripper.width / 2)
    good = np.flatnonzero(alone & pads.any(axis=2).all(axis=1) & (slope <= 1.2 * gripper.friction))
    good = good[rng.permutation(len(good))]
    which, tips = which[good], tips[good]
    yaw = angle[which]
    poses = np.zeros((len(good), 7))
    poses[:, :2], poses[:, 2] = centre[which], tips + gripper.reach
    poses[:, 3], poses[:, 6] = np.cos(yaw / 2), np.sin(yaw / 2)
    kinds = np.column_stack([poses[:, :2] / 0.004, poses[:, 2] / 0.004, yaw / (np.pi / 16)])
    return poses[first_of_each(np.rint(kinds).astype(np.int64))[:count]]


def first_of_each(kinds: Array) -> NDArray[np.intp]:
    """Return the index of the first of each kind of rows (n, k), in their order."""
    _, first = np.unique(kinds, axis=0, return_index=True)
    return np.sort(first)


def _cells(
    heights: HeightMap, centre: Floats, angle: Floats, along: Floats, across: Floats
) -> NDArray[np.intp]:
    """Return flat indices (K, A, S) of the cells on lines beside K places."""
    cos, sin = np.cos(angle)[:, None, None], np.sin(angle)[:, None, None]
    u, v = along, across[:, None]
    x = centre[:, 0, None, None] + cos * u - sin * v
    y = centre[:, 1, None, None] + sin * u + cos * v
    return heights.cells(x, y)
