"""What grasps are planned on: depth image, grid of grasps on the target in it, and height map.

Unlike the image the map has no perspective: what lies under a finger that comes down is one cell,
wherever the camera stands.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter

from mechsearch.camera import Camera, look_at
from mechsearch.geometry import quaternion_from_rotation
from mechsearch.types import Array, Floats, MechSearchError

ANGLES = 16
"""Bins of the closing direction, pi / 16 each."""

DEPTHS = 16
"""Depths of the gripper that are tried, evenly between the target's nearest point and the table."""

FIELD = 96
"""Side of the square that one cell sees [px]; its centre is pixel 48."""

STRIDE = 4
"""Between neighbouring cells [px]."""

NETWORK_OPENING = (0.05, 0.06)
"""Openings of a gripper [m] that the networks can speak for."""

METRIC_HEIGHT = 0.8
"""Of the metric camera above the table [m]."""

_FOCAL = 552.5
"""Of the sensor which the released network was trained for [px]."""

_FIXED_SIZE = 512
"""Side of the fixed camera's image [px]."""


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
        closing, up = np.array([*self.axis, 0.0]), np.array([0.0, 0.0, -1.0])
        local = np.stack([closing, np.cross(up, closing), up], axis=1)
        centre = camera.points_at(self.column, self.row, self.depth)
        return np.array([*centre, *quaternion_from_rotation(camera.pose[:3, :3] @ local)])


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


def surroundings(mask: Array, pad: int) -> tuple[slice, slice]:
    """Return the part of an image that holds a mask and so many pixels around it.

    Args:
        mask: With at least one pixel inside (H, W).
        pad: Pixels around it.
    """
    rows, columns = np.nonzero(mask)
    top, left = max(int(rows.min()) - pad, 0), max(int(columns.min()) - pad, 0)
    return slice(top, int(rows.max()) + pad + 1), slice(left, int(columns.max()) + pad + 1)


@dataclass(frozen=True, eq=False)
class GraspView:
    """A depth image, and where the target is visible in it.

    Attributes:
        depth: Along the optical axis (H, W) float32 [m]; a height map takes 0 for a hole.
        mask: The target's visible pixels (H, W).
        camera: Intrinsics and pose.
        far: Depth of the surface that things stand on, the farthest a gripper may go [m].
    """

    depth: NDArray[np.float32]
    mask: NDArray[np.bool_]
    camera: Camera
    far: float

    @property
    def gripper_depths(self) -> Floats:
        """Depths (16,) [m] of the gripper that are tried, down from the target's nearest point."""
        near = self.depth[self.mask].min() if self.mask.any() else self.far
        return depth_bins(float(near), self.far)

    def around(self, top: int, bottom: int, left: int, right: int) -> NDArray[np.float32]:
        """Return the part of the depth image that cells from one corner to another can see.

        The first cell's field begins 48 px above and left of it, the last one's ends 48 px beyond.
        Beyond its border the image goes on as the surface that things stand on.
        """
        out = np.full((bottom - top + FIELD, right - left + FIELD), self.far, np.float32)
        row, column = top - FIELD // 2, left - FIELD // 2
        y, x = max(-row, 0), max(-column, 0)
        height, width = (max(side, 0) for side in (row + out.shape[0], column + out.shape[1]))
        part = self.depth[row + y : height, column + x : width]
        out[y : y + part.shape[0], x : x + part.shape[1]] = part
        return out


def check_opening(opening: float) -> None:
    """Refuse a gripper that the networks cannot speak for.

    Raises:
        MechSearchError: If it opens too little or too far.
    """
    low, high = NETWORK_OPENING
    if not low <= opening <= high:
        raise MechSearchError(
            f"a gripper that opens {opening * 1000:.0f} mm; the networks know jaws of "
            f"{low * 1000:.0f} to {high * 1000:.0f} mm"
        )


def metric_camera(above: Array, radius: float = 0.3) -> Camera:
    """Return the overhead camera, 0.8 m above the table, that looks down on an object's centre.

    Image columns run along x, rows along -y. The image is as large as grasps on it can see.

    Args:
        above: Centre (3,) [m].
        radius: Of the sphere about it that holds the object [m].
    """
    x, y, z = (float(value) for value in np.asarray(above)[:3])
    distance = max(METRIC_HEIGHT - z - radius, METRIC_HEIGHT / 4)
    size = 2 * (int(np.ceil(_FOCAL * radius / distance)) + FIELD // 2 + 2)
    pose = look_at((x, y, METRIC_HEIGHT), (x, y, 0.0), (0.0, 1.0, 0.0))
    centre = (size - 1) / 2
    return Camera(size, size, _FOCAL, _FOCAL, centre, centre, pose)


@cache
def grasp_camera() -> Camera:
    """Return the fixed camera over the middle of the table, 0.8 m high, that looks straight down.

    Image columns run along x, rows along -y. It sees 0.74 m of the table, in 512 x 512 px.
    """
    pose = look_at((0.0, 0.0, METRIC_HEIGHT), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    centre = (_FIXED_SIZE - 1) / 2
    return Camera(_FIXED_SIZE, _FIXED_SIZE, _FOCAL, _FOCAL, centre, centre, pose)


def segment_view(depth: NDArray[np.float32], segments: Array, number: int = 1) -> GraspView:
    """Return the view of one segment of a scene.

    Args:
        depth: Of the fixed camera (512, 512) [m].
        segments: As in a `GraspScene` (512, 512).
        number: Of the segment that is to be grasped; 1 is the target.

    Raises:
        MechSearchError: If an image has another size than the fixed camera's.
    """
    shape = (_FIXED_SIZE, _FIXED_SIZE)
    if depth.shape != shape or segments.shape != shape:
        raise MechSearchError(
            f"grasp_depth is {depth.shape} and segments {segments.shape}; expected {shape}, as the "
            "fixed camera sees them"
        )
    return GraspView(depth, np.asarray(segments == number), grasp_camera(), METRIC_HEIGHT)


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


def pixels_beside(camera: Camera, nearest: float) -> int:
    """Return how many pixels around a target's a height map is made of.

    Args:
        camera: That looks down.
        nearest: Least depth of the target [m].
    """
    # What stands beside the target may be higher, and so be seen farther out.
    return int(np.ceil(1.6 * _MARGIN * camera.fx / nearest))


def height_map(view: GraspView) -> HeightMap:
    """Return the heights around the visible target.

    What is in shadow, or in holes of depth 0, is taken to be as low as the lowest that is seen
    close by.

    Args:
        view: From a camera whose world has the table at height 0.

    Raises:
        MechSearchError: If the target is not visible.
    """
    rows, columns = np.nonzero(view.mask)
    if not len(rows):
        raise MechSearchError("a height map of a target of which no pixel is visible")
    camera = view.camera
    pad = pixels_beside(camera, float(view.depth[view.mask].min()))
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
    inside = (i > 0) & (j > 0) & (i < shape[0] - 1) & (j < shape[1] - 1) & (depth > 0)
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
