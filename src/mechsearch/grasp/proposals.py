"""Grasps of the paper's jaws, proposed by geometry alone in a depth image."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mechsearch.grippers import ANGLES, GraspView, Gripper, ImageGrasp, bin_angle
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
