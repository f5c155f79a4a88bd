"""Plans grasps: proposals by geometry, each seen in the gripper's own frame, and rated."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mechsearch.geometry import rotation_from_quaternion
from mechsearch.grippers.grasp_view import GraspView, HeightMap, height_map
from mechsearch.grippers.gripper import AnyGripper, Gripper
from mechsearch.grippers.proposals import propose
from mechsearch.types import Floats

PROPOSALS = 100
"""Grasps that are rated, at most."""

LEAST_VISIBLE = 16
"""Pixels of a target from which grasps are planned on it."""

_NEAR, _TURN = 0.01, float(np.cos(np.deg2rad(22.5)))
"""Grasps nearer than this [m] whose closing directions differ by less than this are alike."""

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


def grid_of(gripper: AnyGripper) -> PatchGrid:
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


@dataclass(frozen=True, eq=False)
class RatedGrasps:
    """Grasps, the best first.

    Attributes:
        poses: Of the gripper's frame (K, 7); none where there is nothing to grasp.
        quality: Chance of success (K,) in [0, 1].
    """

    poses: Floats
    quality: Floats

    def __len__(self) -> int:
        return len(self.poses)

    def apart(self, count: int) -> "RatedGrasps":
        """Return the best of them of which no two are alike."""
        closing = rotation_from_quaternion(self.poses[:, 3:])[:, :, 0]
        left = np.ones(len(self), np.bool_)
        chosen: list[int] = []
        while left.any() and len(chosen) < count:
            first = int(np.argmax(left))
            chosen.append(first)
            near = np.linalg.norm(self.poses[:, :3] - self.poses[first, :3], axis=1) < _NEAR
            left &= ~(near & (np.abs(closing @ closing[first]) > _TURN))
            left[first] = False
        return RatedGrasps(self.poses[chosen], self.quality[chosen])


class GraspRater(Protocol):
    """A gripper's grasp quality network, wherever it runs.

    Attributes:
        grid: Of the patches that it sees.
    """

    grid: PatchGrid

    def quality(self, seen: Aligned) -> Floats:
        """Return the chance of success (K,) in [0, 1] of grasps."""


def rate_grasps(network: GraspRater, heights: HeightMap, poses: Floats) -> RatedGrasps:
    """Return grasps (K, 7), the best first."""
    if not len(poses):
        return RatedGrasps(poses, np.empty(0))
    quality = network.quality(aligned(heights, poses, network.grid))
    order = np.argsort(-quality, kind="stable")
    return RatedGrasps(poses[order], quality[order])


def plan_grasps(
    view: GraspView,
    rng: np.random.Generator,
    count: int,
    gripper: AnyGripper,
    network: GraspRater,
) -> RatedGrasps:
    """Return grasps of the target in a view, the best first.

    Args:
        view: From a camera whose world has the table at height 0.
        rng: Draws the proposals.
        count: Of proposals, at most.
        gripper: That grasps.
        network: Its own.
    """
    if view.mask.sum() < LEAST_VISIBLE:
        return RatedGrasps(np.empty((0, 7)), np.empty(0))
    heights = height_map(view)
    return rate_grasps(network, heights, propose(heights, rng, count, gripper))
