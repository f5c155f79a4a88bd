"""Grasps in an image: the grid that they are on, and what they are in the world."""

from dataclasses import dataclass

import numpy as np

from mechsearch.camera import Camera
from mechsearch.geometry import apply
from mechsearch.types import Array, Floats

ANGLES = 16
"""Bins of the closing direction, pi / 16 each."""

DEPTHS = 16
"""Depths of the gripper that are tried, evenly between the target's nearest point and the table."""

FIELD = 96
"""Side of the square that one cell sees [px]; its centre is pixel 48."""

STRIDE = 4
"""Between neighbouring cells [px]."""


@dataclass(frozen=True)
class ImageGrasp:
    """A parallel-jaw grasp along the camera's axis.

    Attributes:
        row: Of the grasp centre [px].
        column: Of the grasp centre [px].
        depth: Of the grasp centre, between the fingertips' ends and the palm [m].
        angle: Of the closing direction [rad], from image right towards image down.
        quality: In [0, 1]; how likely it succeeds.
    """

    row: float
    column: float
    depth: float
    angle: float
    quality: float = float("nan")

    @property
    def axis(self) -> Floats:
        """The closing direction (2,) in the image: right, down."""
        return np.array([np.cos(self.angle), np.sin(self.angle)])

    def pose(self, camera: Camera) -> Floats:
        """Return the pose (7,) of the gripper's frame in the camera's world.

        Its x axis is the closing direction, its z axis runs against the approach, which is the
        optical axis.
        """
        ray = [(self.column - camera.cx) / camera.fx, (self.row - camera.cy) / camera.fy, 1.0]
        local = np.eye(3)
        local[:, 0] = [*self.axis, 0.0]
        local[:, 2] = [0.0, 0.0, -1.0]
        local[:, 1] = np.cross(local[:, 2], local[:, 0])
        centre = apply(camera.pose, self.depth * np.array(ray))
        return np.array([*centre, *_quaternion(camera.pose[:3, :3] @ local)])


def bin_angle(index: Array | int) -> Floats:
    """Return the closing direction [rad] in the middle of angle bins."""
    return np.asarray(np.pi / 2 - (np.asarray(index) + 0.5) * np.pi / ANGLES, np.float64)


def angle_bin(angle: Array | float) -> Array:
    """Return the angle bin of closing directions [rad], which are alike modulo pi."""
    turned = np.mod(np.pi / 2 - np.asarray(angle, np.float64), np.pi)
    return np.minimum((turned * ANGLES / np.pi).astype(np.intp), ANGLES - 1)


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


def alike(centre: Floats, angle: float, centres: Floats, angles: Floats) -> Array:
    """Return which grasps (K,) are less than 1 cm and less than 22.5 degrees from another one.

    Args:
        centre: Of that one (3,) [m].
        angle: Its closing direction [rad].
        centres: Of the grasps (K, 3) [m].
        angles: Their closing directions (K,) [rad].
    """
    turn = np.abs(np.mod(angles - angle + np.pi / 2, np.pi) - np.pi / 2)
    near = np.linalg.norm(centres - centre, axis=1) < 0.01
    result: Array = near & (turn < np.deg2rad(22.5) - 1e-9)
    return result


def _quaternion(rotation: Floats) -> Floats:
    """Return the unit quaternion (4,), scalar first, of a rotation matrix (3, 3)."""
    # Rows of 4 q q^T - I, from the entries of the matrix (Bar-Itzhack, 2000).
    r = rotation
    outer = np.array(
        [
            [r[0, 0] + r[1, 1] + r[2, 2], 0, 0, 0],
            [r[2, 1] - r[1, 2], r[0, 0] - r[1, 1] - r[2, 2], 0, 0],
            [r[0, 2] - r[2, 0], r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], 0],
            [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1]],
        ]
    )
    q: Floats = np.linalg.eigh(outer)[1][:, -1]
    return q if q[0] >= 0 else -q
