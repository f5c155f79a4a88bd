"""A height map: what a camera sees around the target, as heights over the table seen from above.

Unlike the image it has no perspective: what lies under a finger that comes down is one cell,
wherever the camera stands.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter

from mechsearch.grasp.grasp_view import GraspView
from mechsearch.types import Array, Floats, MechSearchError

_CELL = 0.002
"""Side of a cell [m]; the fixed camera's pixels are 1.4 mm apart on the table."""

_MARGIN = 0.12
"""Around the target's visible part [m]."""

_UNIT = 1e-5
"""Heights are compared in whole numbers of this [m]."""

_SHADOW = 9
"""Side of the square of cells from which what is in shadow takes the least height."""


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Heights around the target, and where it is.

    Beyond its border there is the table.

    Attributes:
        height: Of what is seen in each cell (X, Y) float32 [m]; the table is at 0.
        target: Whether that is the target (X, Y).
        corner: Place (2,) of the middle of cell (0, 0): x, y [m].
        cell: Side of a cell [m].
    """

    height: NDArray[np.float32]
    target: NDArray[np.bool_]
    corner: Floats
    cell: float = _CELL

    def cells(self, x: Array, y: Array) -> NDArray[np.intp]:
        """Return the flat index of the cell that each place (...,) [m] is in.

        Places beyond the map get a cell of its border, which is table.
        """
        width, height = self.height.shape
        scale = 1.0 / self.cell
        i = np.clip(np.rint((x - self.corner[0]) * scale), 0, width - 1)
        j = np.clip(np.rint((y - self.corner[1]) * scale), 0, height - 1)
        return np.asarray(i * height + j).astype(np.intp)

    def place(self, flat: Array) -> Floats:
        """Return the middles (..., 2) of cells, by flat index [m]."""
        i, j = np.divmod(flat, self.height.shape[1])
        return self.corner + np.stack([i, j], axis=-1) * self.cell


def height_map(view: GraspView) -> HeightMap:
    """Return the heights around the visible target.

    What is in shadow is taken to be as low as the lowest that is seen close by.

    Args:
        view: From a camera whose world has the table at height 0.

    Raises:
        MechSearchError: If the target is not visible.
    """
    rows, columns = np.nonzero(view.mask)
    if not len(rows):
        raise MechSearchError("a height map of a target of which no pixel is visible")
    camera = view.camera
    # What stands beside the target may be higher, and so be seen farther out.
    pad = int(np.ceil(1.6 * _MARGIN * camera.fx / float(view.depth[view.mask].min())))
    top, left = max(int(rows.min()) - pad, 0), max(int(columns.min()) - pad, 0)
    part = slice(top, int(rows.max()) + pad + 1), slice(left, int(columns.max()) + pad + 1)
    depth, mask = view.depth[part], view.mask[part]
    x = (np.arange(left, left + depth.shape[1], dtype=np.float32) - camera.cx) / camera.fx * depth
    y = (np.arange(top, top + depth.shape[0], dtype=np.float32) - camera.cy)[:, None]
    y = y / camera.fy * depth
    pose = camera.pose.astype(np.float32)
    world = [r[0] * x + r[1] * y + r[2] * depth + r[3] for r in pose[:3]]
    own = [axis[mask] for axis in world[:2]]
    corner = np.array([axis.min() - _MARGIN for axis in own], np.float64)
    shape = [
        int((axis.max() + _MARGIN - low) / _CELL) + 2 for axis, low in zip(own, corner, strict=True)
    ]
    i, j = (np.rint((axis - low) / _CELL).astype(np.int32)
            for axis, low in zip(world[:2], corner, strict=True))  # fmt: skip
    inside = (i > 0) & (j > 0) & (i < shape[0] - 1) & (j < shape[1] - 1)
    # Height and target in one number, so that the highest point brings along whose it is.
    value = np.rint(np.maximum(world[2], 0.0) / _UNIT).astype(np.int32) * 2 + mask
    highest = np.full(shape[0] * shape[1], -1, np.int32)
    np.maximum.at(highest, (i * shape[1] + j)[inside], value[inside])
    highest = highest.reshape(shape)
    height = (highest >> 1) * np.float32(_UNIT)
    unseen = highest < 0
    height[unseen] = np.inf
    height[[0, -1]] = height[:, [0, -1]] = 0.0
    low = minimum_filter(height, _SHADOW)
    height[unseen] = np.where(np.isfinite(low), low, 0.0)[unseen]
    return HeightMap(height.astype(np.float32), (highest & 1).astype(np.bool_) & ~unseen, corner)
