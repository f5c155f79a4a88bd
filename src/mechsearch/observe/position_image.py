"""The mid-level representation (paper, section III-B): where the visible target is, pixelwise."""

import numpy as np
from numpy.typing import NDArray

from mechsearch.camera import Camera
from mechsearch.types import Array, MechSearchError


def position_image(
    mask: Array, depth: Array, camera: Camera, ee_position: Array
) -> NDArray[np.float16]:
    """Return the offset from end effector to target of every visible target pixel.

    Args:
        mask: Visible target pixels (H, W) bool.
        depth: Depth image (H, W) [m]; pixels without a measurement are 0 and are left out.
        camera: Intrinsics and pose of the image.
        ee_position: End effector (3,) [m], world frame.

    Returns:
        Offsets (3, H, W) [m] in world axes, 0 off the target.

    Raises:
        MechSearchError: If mask, depth and camera differ in size.
    """
    shape = (camera.height, camera.width)
    if mask.shape != shape or depth.shape != shape:
        raise MechSearchError(
            f"mask {mask.shape} and depth {depth.shape} must both be the camera's {shape}"
        )
    image = np.zeros((3, *shape), np.float16)
    rows, columns = np.nonzero(mask & (depth > 0))
    z = depth[rows, columns].astype(np.float64)
    local = np.stack(
        [(columns - camera.cx) / camera.fx * z, (rows - camera.cy) / camera.fy * z, z], axis=1
    )
    pose = camera.pose
    offsets = local @ pose[:3, :3].T + pose[:3, 3] - np.asarray(ee_position, np.float64)
    image[:, rows, columns] = offsets.T
    return image
