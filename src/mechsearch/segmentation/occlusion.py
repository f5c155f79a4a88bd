"""How much of a known object others hide, by one image, its mask there, and views of it."""

import importlib
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, cast

import numpy as np
from numpy.typing import NDArray

from mechsearch.camera import Camera
from mechsearch.observe.observation import MOST_HOLES, without_holes
from mechsearch.types import Array, Floats, check_extra

PATCH_SIDE, PATCH_CHANNELS, PATCH_NUMBERS = 48, 3, 5
"""Side of what is seen about a mask [px], its channels, and the numbers beside it."""

_LEAST_PIXELS = 6
"""Of a mask; of a smaller one nothing can be told."""

_PIXEL = 0.0054
"""Side of a patch's pixel on the table [m]."""

_NETWORK = "mechsearch.segmentation.occlusion_network"


@dataclass(frozen=True)
class Occlusion:
    """What is believed of an object.

    Attributes:
        hidden: Share of it that others hide, in [0, 1].
        uncovered: Chance that this is at most `types.CALLED_UNCOVERED`.
    """

    hidden: float
    uncovered: float


class OcclusionEstimator(Protocol):
    """Estimates how much of an object is hidden from what `patch_of` returns."""

    def estimate(self, patch: Array, numbers: Array) -> Occlusion:
        """Return what is believed of an object."""


def make_estimator(path: Path | None = None) -> OcclusionEstimator:
    """Return the estimator that a network is; None takes the one that comes with the package.

    Raises:
        MechSearchError: If the file is missing, damaged or of another network, or PyTorch is
            missing.
    """
    check_extra("an estimate of occlusion", "learn")
    return cast("OcclusionEstimator", importlib.import_module(_NETWORK).network_estimator(path))


def silhouette_areas(mask: NDArray[np.bool_], width: NDArray[np.float32]) -> Floats:
    """Return the least, middle and greatest area (3,) of an object's whole silhouettes [m^2].

    An object of unknown size, as on photographs from no known distance, counts as 10 cm^2.

    Args:
        mask: Of reference views (V, S, S).
        width: Of what each shows (V,) [m]; 0 where it is not known.
    """
    areas = mask.mean(axis=(1, 2)) * width.astype(np.float64) ** 2
    known = areas[areas > 0]
    if not len(known):
        return np.full(3, 1e-3)
    return np.array([known.min(), np.median(known), known.max()])


def can_be_judged(depth: Array, mask: Array) -> bool:
    """Return whether a mask is not tiny, and less than half of a depth image is holes."""
    holes = 1 - ((depth > 0) & (depth < np.inf)).mean()
    return bool(mask.sum() >= _LEAST_PIXELS and holes < MOST_HOLES)


def patch_of(
    depth: Array, camera: Camera, mask: Array, areas: Floats
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return what a network sees of a mask: the patch about it (3, 48, 48), and numbers (5,).

    The patch holds height over that of the mask, the mask, and holes; the numbers compare what is
    visible with the silhouettes, and tell its size and height.

    Args:
        depth: Along the optical axis (H, W) [m]; 0 or not finite in holes.
        camera: Where it is believed to be, in a world whose table is at height 0.
        mask: Where the object is seen (H, W) bool; see `can_be_judged`.
        areas: Of its silhouettes (3,); see `silhouette_areas`.
    """
    holes = ~((depth > 0) & (depth < np.inf))
    if holes.any():
        depth = without_holes(np.where(holes, 0, depth).astype(np.float32), "depth")
    pose, own = camera.pose, depth[mask].astype(np.float64)
    pixel = float(np.median(own)) / camera.fx
    # Of images of another resolution some pixels are passed over, or seen several times.
    step = _PIXEL / pixel if abs(np.log(_PIXEL / pixel)) > np.log(1.5) else 1.0
    inside = np.nonzero(mask)
    offsets = np.rint((np.arange(PATCH_SIDE) - PATCH_SIDE // 2) * step).astype(np.intp)
    rows, columns = (round(float(axis.mean())) + offsets for axis in inside)
    beyond = ((rows < 0) | (rows >= camera.height))[:, None] | (
        (columns < 0) | (columns >= camera.width)
    )
    rows, columns = rows.clip(0, camera.height - 1), columns.clip(0, camera.width - 1)

    def height(row: Array, column: Array, z: Array) -> Floats:
        x, y = (column - camera.cx) / camera.fx, (row - camera.cy) / camera.fy
        return np.asarray(z * (pose[2, 0] * x + pose[2, 1] * y + pose[2, 2]) + pose[2, 3])

    level = float(np.median(height(inside[0], inside[1], own)))
    where = np.ix_(rows, columns)
    near = height(rows[:, None], columns[None], depth[where].astype(np.float64))
    patch = np.zeros((PATCH_CHANNELS, PATCH_SIDE, PATCH_SIDE), np.float32)
    patch[0] = np.clip((near - level) * 20, -2, 2)
    patch[1], patch[2] = mask[where] & ~beyond, holes[where] & ~beyond
    visible = float((own**2).sum()) / (camera.fx * camera.fy)
    count = len(own) / step**2
    numbers = [*np.log(visible / areas), np.log(count) - 4, 10 * level]
    return patch, np.array(numbers, np.float32)
