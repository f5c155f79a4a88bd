"""What a grasp quality network sees of grasps: patches of the height map in the gripper's frame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mechsearch.geometry import rotation_from_quaternion
from mechsearch.grasp.height_map import HeightMap
from mechsearch.sim.gripper import Gripper, SuctionCup
from mechsearch.types import Floats

GRASP_NUMBERS = 6
"""How many numbers a grasp has beside its patch."""


@dataclass(frozen=True)
class PatchGrid:
    """The cells of a patch, about the grasp centre.

    Attributes:
        rows: Cells along the gripper's y axis.
        columns: Cells along its x axis, the closing direction.
        cell: Side of a cell [m].
    """

    rows: int
    columns: int
    cell: float

    @property
    def square(self) -> bool:
        """Whether both sides are alike."""
        return self.rows == self.columns


JAWS_GRID, SUCTION_GRID = PatchGrid(32, 64, 0.002), PatchGrid(32, 32, 0.002)


@dataclass(frozen=True, eq=False)
class Aligned:
    """What is seen of grasps (K,), each in its gripper's own frame.

    Attributes:
        relative: How far what is seen rises over the plane of the gripper's x and y axes (K, R, C)
            float32 [m].
        target: Whether it is the target (K, R, C).
        numbers: (K, 6) float32: height of the grasp centre over the table [m]; x and y of the
            vertical in the gripper's frame; x and y of the middle of the target's visible part
            [m]; square root of that part's area [m].
    """

    relative: NDArray[np.float32]
    target: NDArray[np.bool_]
    numbers: NDArray[np.float32]


def grid_of(gripper: Gripper | SuctionCup) -> PatchGrid:
    """Return the cells of a gripper's patches."""
    return JAWS_GRID if isinstance(gripper, Gripper) else SUCTION_GRID


def aligned(heights: HeightMap, poses: Floats, grid: PatchGrid) -> Aligned:
    """Return what is seen of grasps (K, 7) in a height map."""
    rotation = rotation_from_quaternion(poses[:, 3:])
    axes, centre = rotation.astype(np.float32), poses[:, :3].astype(np.float32)
    v, u = (
        ((np.arange(count) - (count - 1) / 2) * grid.cell).astype(np.float32)
        for count in (grid.rows, grid.columns)
    )
    x, y, z = (
        centre[:, i, None, None]
        + axes[:, i, 0, None, None] * u
        + axes[:, i, 1, None, None] * v[:, None]
        for i in range(3)
    )
    cells = heights.cells(x, y)
    relative = (heights.height.ravel()[cells] - z) * axes[:, 2, 2, None, None]
    own = heights.place(np.flatnonzero(heights.target))
    middle = np.array([*own.mean(axis=0), 0.0]) - poses[:, :3]
    middle[:, 2] = 0.0
    offset = (middle[:, :, None] * rotation).sum(axis=1)
    numbers = np.column_stack([
        poses[:, 2], rotation[:, 2, :2], offset[:, :2],
        np.full(len(poses), heights.cell * np.sqrt(len(own))),
    ])  # fmt: skip
    return Aligned(relative, heights.target.ravel()[cells], numbers.astype(np.float32))
