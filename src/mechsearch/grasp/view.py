"""What a grasp is planned on: a depth image, the target's visible region, and the camera."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mechsearch.camera import Camera, look_at
from mechsearch.grasp.grid import FIELD
from mechsearch.objects.model import ObjectModel
from mechsearch.render.renderer import Renderer
from mechsearch.types import Array, Floats, MechSearchError

NETWORK_OPENING = (0.05, 0.06)
"""Openings of a gripper [m] that the networks can speak for."""

METRIC_HEIGHT = 0.8
"""Of the metric camera above the table [m]."""

_FOCAL = 552.5

_WIDTH_PX = (23.0, 46.0)
"""Width of a 5 cm gripper at the target [px]: where the released network's scores were found
steady; 0.8 m below the metric camera it is 34.5."""


@dataclass(frozen=True, eq=False)
class GraspView:
    """A depth image without holes, and where the target is visible in it.

    Attributes:
        depth: Along the optical axis (H, W) float32 [m].
        mask: The target's visible pixels (H, W).
        camera: Intrinsics and pose.
        far: Depth of the surface that things stand on, the farthest a gripper may go [m].
    """

    depth: NDArray[np.float32]
    mask: NDArray[np.bool_]
    camera: Camera
    far: float

    def around(self, top: int, bottom: int, left: int, right: int) -> NDArray[np.float32]:
        """Return the part of the depth image that cells from one corner to another can see.

        The first cell's field begins 48 px above and left of it, the last one's ends 48 px beyond.
        Beyond its border the image goes on as the surface that things stand on.
        """
        half = FIELD // 2
        out = np.full((bottom - top + FIELD, right - left + FIELD), self.far, np.float32)
        row, column = top - half, left - half
        rows = slice(max(row, 0), max(row + out.shape[0], 0))
        columns = slice(max(column, 0), max(column + out.shape[1], 0))
        part = self.depth[rows, columns]
        y, x = rows.start - row, columns.start - column
        out[y : y + part.shape[0], x : x + part.shape[1]] = part
        return out


def view_of_image(depth: Array, mask: Array, camera: Camera) -> GraspView:
    """Return a user's depth image, checked and filled.

    Holes (0 or not finite) take the median of the other pixels, and are no part of the target.

    Args:
        depth: (H, W) or (H, W, 1) [m].
        mask: The target (H, W) or (H, W, 1), bool or 0 where it is not.
        camera: Its size must be the image's.

    Raises:
        MechSearchError: If sizes differ, depths are no metres, most of the image is holes, no pixel
            of the target is visible, or the target is too near or far for the networks.
    """
    raw, inside = _flat("depth image", depth), _flat("mask", mask) != 0
    if inside.shape != raw.shape:
        raise MechSearchError(f"the mask is {inside.shape}, the depth image {raw.shape}")
    if (camera.height, camera.width) != raw.shape:
        raise MechSearchError(
            f"the depth image is {raw.shape}, but the intrinsics are for "
            f"{(camera.height, camera.width)}"
        )
    metres = raw.astype(np.float32)
    seen = np.isfinite(metres) & (metres > 0)
    if seen.mean() < 0.25:
        raise MechSearchError(
            f"{1 - seen.mean():.0%} of the depth image are holes (0 or not finite); expected less "
            "than 75%"
        )
    middle = float(np.median(metres[seen]))
    if middle > 20.0:
        raise MechSearchError(
            f"the median depth is {middle:.0f}; expected metres, so divide millimetres by 1000"
        )
    inside = inside & seen
    if not inside.any():
        raise MechSearchError("the mask has no pixel with a depth: no target is visible")
    width = camera.fx * NETWORK_OPENING[0] / float(np.median(metres[inside]))
    if not _WIDTH_PX[0] <= width <= _WIDTH_PX[1]:
        raise MechSearchError(
            f"at the target a 5 cm gripper is {width:.0f} px wide; the networks know "
            f"{_WIDTH_PX[0]:.0f} to {_WIDTH_PX[1]:.0f} px, so resize image, mask and intrinsics by "
            f"about {34.5 / width:.2f}"
        )
    filled = np.where(seen, metres, np.float32(middle)).astype(np.float32)
    return GraspView(filled, inside, camera, float(filled.max()))


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

    Image columns run along x, rows along -y. The focal length is that of the sensor which the
    released network was trained for. The image is as large as grasps on the object can see.

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


def view_of_heap(models: Sequence[ObjectModel], poses: Array, target: int) -> GraspView:
    """Return the noise-free metric view of objects at rest, the robot out of sight.

    Args:
        models: The objects.
        poses: Of theirs (N, 7).
        target: Its index; the camera looks down on its centre.
    """
    camera = metric_camera(poses[target], models[target].radius)
    # An edge of the table would look like a drop that no gripper needs to heed.
    frame = Renderer(models, table_half=100.0).frame(camera, poses)
    return GraspView(frame.depth, frame.modal(target), camera, METRIC_HEIGHT)


def view_of_target(model: ObjectModel, pose: Floats) -> GraspView:
    """Return the metric view of the target where it lies, all clutter removed."""
    return view_of_heap([model], pose[None], 0)


def _flat(name: str, image: Array) -> Array:
    array = np.asarray(image)
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[..., 0]
    if array.ndim != 2:
        raise MechSearchError(f"the {name} has shape {array.shape}; expected (H, W)")
    return array
