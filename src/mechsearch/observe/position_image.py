"""The mid-level representation (paper, section III-B): where the visible target is, pixelwise."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mechsearch.camera import Camera
from mechsearch.types import Array, Floats, MechSearchError


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
    pixels = mask.ravel().nonzero()[0]
    z = depth.take(pixels)
    if not z.all():
        pixels, z = pixels[z > 0], z[z > 0]
    origin, rays = _rays(camera)
    offsets = rays.take(pixels, axis=1) * z + (origin - ee_position)[:, None]
    image.reshape(3, -1)[:, pixels] = offsets
    return image


@lru_cache(maxsize=8)
def _rays(camera: Camera) -> tuple[Floats, Floats]:
    """Return where the camera is (3,), and its pixels' rays (3, H W) in world axes."""
    pose = camera.pose
    rays = camera.directions().reshape(-1, 3) @ pose[:3, :3].T
    return pose[:3, 3], np.ascontiguousarray(rays.T)
