"""What an observation's images tell about a heap: no privileged position is read."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mechsearch.camera import Camera
from mechsearch.types import Array, Floats, Observation

_FINGERS = 0.022
"""Distance from the end effector's axis within which a point is taken for the fingers [m]."""

_ABOVE_HEAPS = 0.3
_ON_TABLE = 0.012
"""Points lower than this belong to the table [m]; depth is known to half a millimetre."""


@dataclass(frozen=True)
class Sight:
    """A heap as a camera sees it.

    Attributes:
        heights: Above the table, by pixel (H, W) [m]; 0 where the end effector hides it.
        target: Visible pixels of the target (H, W).
        centre: Middle of the target's visible surface (3,) [m], or None where none is visible.
        obstacles: Points on everything that stands on the table (N, 3) [m].
        ee_position: End effector (3,) [m].
        camera: Of the images.
    """

    heights: Floats
    target: NDArray[np.bool_]
    centre: Floats | None
    obstacles: Floats
    ee_position: Floats
    camera: Camera


def look(obs: Observation, camera: Camera) -> Sight:
    """Return what an observation shows.

    Args:
        obs: With "depth", "position_image" and "ee_position".
        camera: Of its images.

    Raises:
        MechSearchError: If the images have another size than the camera's.
    """
    points = camera.back_project(np.asarray(obs["depth"])[0])
    ee = np.asarray(obs["ee_position"], np.float64)
    heights = np.where(_is_end_effector(points, ee), 0.0, points[..., 2])
    offsets = np.asarray(obs["position_image"], np.float64)
    target: NDArray[np.bool_] = (offsets != 0).any(axis=0)
    centre = offsets[:, target].mean(axis=1) + ee if target.any() else None
    standing = (heights > _ON_TABLE) & _every_second(*heights.shape)
    return Sight(heights, target, centre, points[standing], ee, camera)


def _is_end_effector(points: Floats, ee: Floats) -> Array:
    away = points - ee
    beside = np.hypot(away[..., 0], away[..., 1]) < _FINGERS
    return (beside & (away[..., 2] > -0.01)) | (points[..., 2] > _ABOVE_HEAPS)


@lru_cache(maxsize=8)
def _every_second(height: int, width: int) -> NDArray[np.bool_]:
    """Return every second pixel of every second row: enough to find a way between objects."""
    mask = np.zeros((height, width), np.bool_)
    mask[::2, ::2] = True
    return mask
