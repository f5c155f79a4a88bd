"""The grid of grasps: every fourth pixel, 16 closing directions, 16 depths of the gripper."""

import numpy as np

from mechsearch.types import Array, Floats

ANGLES = 16
"""Bins of the closing direction, pi / 16 each."""

DEPTHS = 16
"""Depths of the gripper that are tried, evenly between the target's nearest point and the table."""

FIELD = 96
"""Side of the square that one cell sees [px]; its centre is pixel 48."""

STRIDE = 4
"""Between neighbouring cells [px]."""


def depth_bins(near: float, far: float, count: int = DEPTHS) -> Floats:
    """Return the middles of `count` equal bins between two depths [m]."""
    return near + (np.arange(count) + 0.5) * (far - near) / count


def cells(mask: Array) -> tuple[Array, Array]:
    """Return rows and columns (C,) of every fourth pixel that is inside a mask (H, W).

    A region so small that the grid misses it gets one cell, the pixel nearest to its centroid.

    Args:
        mask: With at least one pixel inside.
    """
    rows, columns = np.nonzero(mask[::STRIDE, ::STRIDE])
    if len(rows):
        return rows * STRIDE, columns * STRIDE
    rows, columns = np.nonzero(mask)
    nearest = np.argmin((rows - rows.mean()) ** 2 + (columns - columns.mean()) ** 2)
    return rows[nearest : nearest + 1], columns[nearest : nearest + 1]
