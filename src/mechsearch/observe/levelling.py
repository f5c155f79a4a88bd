"""Holds an image against the table that it shows, and corrects what the camera got wrong."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from mechsearch.camera import Camera
from mechsearch.types import Array, Floats

_LOW = 0.03
"""Within this of the table's height a pixel may show the table [m]: more than cameras err."""

_NEARER = (0.02, 0.012, 0.008, 0.006)
"""How near the table found so far a pixel must be to count for the next one [m]."""

_SAMPLES = 5000
"""About how many pixels of an image are read at most."""

_LEAST = 0.05
"""Share of them that must show the table."""

_RESOLUTION = 0.001
"""An image whose table is nowhere off by more than this is left alone [m]."""

_FAR, _TURNED = 0.03, np.deg2rad(3.0)
"""What is taken for the table is not, if it is off by more than this [m], or tilted."""


def levelled(depth: Array, camera: Camera) -> tuple[Array, Camera]:
    """Return depth and camera as they are once the table lies at height 0.

    A plane is fitted to what is near that height. Its distance tells by which factor depths are
    wrong, and its tilt how the camera is turned about axes along the table, which moves all that it
    sees sideways as well. A turn about the vertical, and a shift along the table, do not show.
    Where the plane is off by no more than a millimetre, or no table is found, depth and camera are
    returned as they are.

    Args:
        depth: Along the optical axis (H, W) [m]; 0 or not finite in holes.
        camera: Its intrinsics, and its pose as it is believed to be; the table is at height 0.

    Returns:
        Depth of the same kind, and a camera.
    """
    found = _table(depth, camera)
    if found is None:
        return depth, camera
    plane, true = found
    seen, known = np.linalg.norm(plane), np.linalg.norm(true)
    # The shortest turn; for angles as small as these, a sine is its angle.
    turn = Rotation.from_rotvec(np.cross(plane / seen, true / known)).as_matrix()
    pose = camera.pose
    pose[:3, :3] = pose[:3, :3] @ turn
    depths = depth * np.asarray(seen / known, depth.dtype)
    return depths, replace(camera, world_from_camera=tuple(pose.ravel().tolist()))


def _table(depth: Array, camera: Camera) -> tuple[Floats, Floats] | None:
    """Return the table as it is seen and as it should be, or None if there is nothing to correct.

    A plane is the vector (3,) [1/m] whose product with each of its points, in the camera's frame,
    is 1: over depth, its product with a ray.
    """
    step = max(int(np.sqrt(depth.size / _SAMPLES)), 1)
    eye = camera.pose[2]
    true = -eye[:3] / eye[3]
    z = depth[::step, ::step].astype(np.float64).ravel()
    rows, columns = (step * np.arange(-(-side // step)) for side in depth.shape)
    across, down = (columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy
    rays = np.stack([*map(np.ravel, np.meshgrid(across, down)), np.ones(z.size)], axis=1)
    seen = (z > 0) & (z < np.inf) & (rays @ true > 0)
    z, rays = z[seen], rays[seen]
    # Points over the depth at which they would be on the table, so that all count alike.
    expected = rays @ true
    points = rays / expected[:, None]
    heights = (1 - z * expected) * eye[3]
    plane = true
    for tolerance in (_LOW, *_NEARER):
        near = np.abs(heights) < tolerance
        if near.sum() < max(_LEAST * len(near), 3):
            return None
        plane, *_ = np.linalg.lstsq(points[near], 1 / (z * expected)[near], rcond=None)
        heights = (1 - z * (rays @ plane)) * eye[3]
    off = float(np.abs(points[near] @ plane - 1).max()) * float(eye[3])
    cosine = plane @ true / (np.linalg.norm(plane) * np.linalg.norm(true))
    if not _RESOLUTION < off < _FAR or cosine < np.cos(_TURNED):
        return None
    return plane, true
