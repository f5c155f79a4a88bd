"""Makes one pixel of several, so that an image is no finer than a policy reads it."""

from dataclasses import replace
from typing import TypeVar

import numpy as np

from mechsearch.camera import Camera, edge_step
from mechsearch.types import Array

Given = TypeVar("Given", Array, Array | None)


def bins_of(camera: Camera, view: Camera) -> int:
    """Return how many pixels of a camera fit along a side of one of a view, on the table; or 1.

    Both are above the table, and look down at it.
    """
    return max(int(_density(camera) / _density(view) + 1e-6), 1)


def _density(camera: Camera) -> float:
    """Return how many pixels there are to a metre where a camera's optical axis meets the table."""
    _, _, down, height = camera.pose[2].tolist()
    return float(camera.fx * -down / height)


def binned(
    depth: Array, camera: Camera, bins: int, mask: Given, colour: Array | None = None
) -> tuple[Array, Camera, Given, Array | None]:
    """Return an image whose pixels are as large as several along each side.

    A depth is the median of those that were measured: noise is averaged, what flies between two
    surfaces does not count, and there is a hole only where nothing was measured. A mask is that of
    most pixels, and of two as frequent the one of the greater number; a colour is the mean. Rows
    and columns that are left over, below and on the right, are left out.

    Args:
        depth: (H, W) [m], 0 in holes.
        camera: Of that image.
        bins: Pixels along each side of a larger one; for 1 all is returned as it is.
        mask: Bool, or whole numbers of several masks (H, W), or None.
        colour: (H, W, 3) uint8.

    Returns:
        Depth, camera, mask and colours.
    """
    if bins == 1:
        return depth, camera, mask, colour
    rows, columns = (side // bins for side in depth.shape)
    whole = replace(camera, width=columns * bins, height=rows * bins)

    def parts(image: Array) -> Array:
        """Return the pixels of each larger one (rows, columns, bins^2, ...)."""
        sides = rows, bins, columns, bins, *image.shape[2:]
        cut = image[: rows * bins, : columns * bins].reshape(sides).swapaxes(1, 2)
        return cut.reshape(rows, columns, bins**2, *image.shape[2:])

    if mask is not None:
        numbers, own = np.unique(mask)[::-1], parts(np.asarray(mask))
        counts = np.stack([(own == number).sum(axis=-1) for number in numbers])
        mask = numbers[counts.argmax(axis=0)]
    if colour is not None:
        colour = np.rint(parts(np.asarray(colour)).mean(axis=2)).astype(np.uint8)
    return _medians(parts(depth), camera), whole.resized(rows, columns), mask, colour


def _medians(depths: Array, camera: Camera) -> Array:
    """Return the medians of what is above 0 in the last axis (..., N), or 0 where nothing is.

    Of two in the middle it is the mean, or the nearer, if neighbours of a camera's image that
    differ so much are at an edge.
    """
    count = (depths > 0).sum(axis=-1, keepdims=True)
    # A depth that no pixel has stands behind all.
    rising = np.sort(np.where(depths > 0, depths, np.finfo(depths.dtype).max), axis=-1)
    near, far = (
        np.take_along_axis(rising, np.maximum(middle, 0), axis=-1)[..., 0]
        for middle in ((count - 1) // 2, count // 2)
    )
    near = np.where(count[..., 0] > 0, near, 0)
    between = np.where(far - near < edge_step(near, camera), (far - near) / 2, 0)
    return (near + between).astype(depths.dtype)
