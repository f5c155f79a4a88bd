"""What a grasp is planned on: a depth image, the target's visible region, and the camera."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mechsearch.camera import Camera, look_at
from mechsearch.grasp.image_grasp import FIELD
from mechsearch.objects.model import ObjectModel
from mechsearch.render.renderer import Renderer
from mechsearch.types import Array, MechSearchError

NETWORK_OPENING = (0.05, 0.06)
"""Openings of a gripper [m] that the networks can speak for."""

METRIC_HEIGHT = 0.8
"""Of the metric camera above the table [m]."""

_FOCAL = 552.5


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
