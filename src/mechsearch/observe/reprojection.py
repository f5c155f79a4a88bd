"""Brings the images of any calibrated camera into the view that a policy knows."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mechsearch.camera import Camera, edge_step
from mechsearch.observe.binning import binned, bins_of
from mechsearch.observe.levelling import levelled
from mechsearch.observe.observation import check_metres, measured_pixels
from mechsearch.types import Array, Floats, MechSearchError

_TABLE_HALF, _TABLE_ERROR = 0.4, 0.03
"""Half the side of the table, and how far below it a point of it may be measured [m]."""


@dataclass(frozen=True)
class Reprojection:
    """What one camera would have seen, as far as another one saw it.

    Attributes:
        depth: (H, W) float32 [m], 0 in holes: where the other camera saw nothing.
        mask: (H, W) as given, false or 0 in holes; None if none was given.
        colour: (H, W, 3) uint8, 0 in holes; None if none was given.
    """

    depth: Array
    mask: Array | None
    colour: Array | None


def reproject(
    depth: Any,
    camera: Camera,
    view: Camera,
    mask: Any = None,
    colour: Any = None,
    bins: bool = False,
) -> Reprojection:
    """Return the images of any calibrated camera in the view that a policy knows.

    The image is held against the table that it shows; see `levelled`. In each pixel of the view is
    then what is seen in its middle: the nearest surface there. Surfaces go on between pixels of the
    image, and end half way between them at an edge; mask and colour are those of the pixel next to
    the middle. Holes are left to `without_holes`, as of any camera.

    Args:
        depth: (H, W), floating-point numbers [m]; holes as in `without_holes`, in any number.
        camera: Intrinsics and pose of that image.
        view: Of the policy, such as `camera.preset(policy.camera, policy.image_size)`.
        mask: Pixels of the target (H, W) bool in the same image, or whole numbers of several masks.
        colour: (H, W, 3) uint8, likewise.
        bins: Whether an image that has noise and is much finer than the view is first made coarser,
            see `binned`; surfaces then end where the larger pixels do, of which at least two go to
            one of the view, so that borders stay where they are.

    Raises:
        MechSearchError: If images and camera differ in size, the camera is below the table, which
            is at height 0, or looks away from it, all of the image is holes, or nothing of it is in
            the view.
    """
    shape = (camera.height, camera.width)
    image, measured = measured_pixels(depth, "depth")
    if image.shape != shape:
        raise MechSearchError(f"depth has shape {image.shape}; this camera's is {shape}")
    beside = {"mask": (mask, shape), "colour": (colour, (*shape, 3))}
    for name, (given, expected) in beside.items():
        if given is not None and np.shape(given) != expected:
            raise MechSearchError(f"{name} has shape {np.shape(given)}; expected {expected}")
    place, ahead = camera.pose[:3, 3], camera.pose[:3, 2]
    if place[2] <= 0:
        raise MechSearchError(
            f"the camera is at {_shown(place)} m, below the table; expected a height above 0: is "
            "its pose the camera's in the world?"
        )
    if ahead[2] >= 0:
        raise MechSearchError(
            f"the camera looks along {_shown(ahead)}, away from the table; "
            "expected downwards: its z axis is the optical axis"
        )
    if measured is None:
        measured = np.ones(shape, np.bool_)
    if not measured.any():
        raise MechSearchError("depth has no depth, 0 or not finite, in any of its pixels")
    check_metres(image[measured], "depth")
    image = np.where(measured, image, 0).astype(np.float32)
    if bins:
        count = max(bins_of(camera, view) // 2, 1)
        image, camera, mask, colour = binned(image, camera, count, mask, colour)
    image, camera = levelled(image, camera)
    near, found = _into(image, camera, view)
    if not (found >= 0).any():
        raise MechSearchError(
            f"nothing that the camera at {_shown(place)} m sees is in the view of the policy's "
            f"camera at {_shown(view.pose[:3, 3])} m; expected both to see the table"
        )
    holes = found < 0

    def taken(values: Any, kind: Any = None) -> Array | None:
        if values is None:
            return None
        array = np.asarray(values, kind)
        picked: Array = array.reshape(-1, *array.shape[2:])[found]
        picked[holes] = 0
        return picked

    return Reprojection(near, taken(mask), taken(colour, np.uint8))


def _into(depth: Array, camera: Camera, view: Camera) -> tuple[Array, NDArray[np.intp]]:
    """Return depth (H, W) [m] in a view, 0 in holes, and the pixel seen there; -1 in holes.

    Four pixels are the corners of a cell, and all cells are drawn into the view. At an edge each
    corner has its own part of the cell.
    """
    # With holes around the image, its last pixels too reach half way beyond their middles.
    depth = np.pad(depth, 1)
    width = depth.shape[1]
    # Over depth, homogeneous places in the view are linear in column, row and one over depth.
    onto = np.linalg.inv(_from_pixels(view)) @ np.linalg.solve(view.pose, camera.pose)
    onto = (onto @ _from_pixels(camera)).astype(np.float32)
    place = np.zeros((4, *depth.shape), np.float32)
    np.divide(1, depth, out=place[3], where=depth > 0)
    down, right = (np.arange(n, dtype=np.float32) - 1 for n in depth.shape)
    for row, out in zip(onto[:3], place[:3], strict=True):
        np.multiply(place[3], row[3], out=out)
        out += row[0] * right
        out += (row[1] * down + row[2])[:, None]
    depth[place[2] <= 0] = 0
    nearest, farthest = _of_corners(np.minimum, depth), _of_corners(np.maximum, depth)
    drawn = (nearest > 0) & (farthest - nearest <= edge_step(nearest, camera))
    edge = ~drawn & (farthest > 0)
    ahead = np.where(depth > 0, place[2], 1)
    for one, length in zip(place, (view.width, view.height), strict=False):
        # Where the middle of a pixel of the view is in a cell, its corners round up differently.
        up = np.clip(np.ceil(one / ahead), -1, length + 1).astype(np.int16)
        first, last = _of_corners(np.minimum, up), _of_corners(np.maximum, up)
        drawn &= first < last
        edge &= (last >= 0) & (first <= length)
    beside = np.array([[0], [1], [width], [width + 1]])
    whole, apart = (
        np.flatnonzero(np.pad(cells, ((0, 0), (0, 1)))) + beside for cells in (drawn, edge)
    )
    place, depth = place.reshape(4, -1), depth.ravel()
    parts, corner = _parts(place[:, apart], depth[apart], onto[:3, :2], camera)
    near, found = _seen(
        np.concatenate([place[:, whole], parts], axis=2),
        np.concatenate([whole, np.tile(apart.ravel()[corner], (4, 1))], axis=1),
        view,
    )
    row, column = np.divmod(found, width)
    return near, np.where(found < 0, -1, (row - 1) * camera.width + column - 1)


def _from_pixels(camera: Camera) -> Floats:
    """Return what takes column, row, 1 and one over depth to a point over depth (4, 4)."""
    matrix = np.diag([1 / camera.fx, 1 / camera.fy, 1, 1])
    matrix[:2, 2] = -camera.cx / camera.fx, -camera.cy / camera.fy
    return matrix


def _of_corners(reduce: np.ufunc, image: Array) -> Array:
    """Return what `reduce` makes of the corners of each cell of an image (H - 1, W - 1)."""
    rows = reduce(image[:-1], image[1:])
    reduced: Array = reduce(rows[:, :-1], rows[:, 1:])
    return reduced


def _parts(
    place: Array, depth: Array, steps: Array, camera: Camera
) -> tuple[Array, NDArray[np.intp]]:
    """Return the parts of cells at edges, as cells: half way to both neighbours of each corner.

    Where an edge is between neighbours, the surface goes on to there at the corner's own depth.

    Args:
        place: Homogeneous places of corners and one over depth, all over depth (4, 4, E): left and
            right above, left and right below.
        depth: (4, E) [m], 0 in holes.
        steps: By which such a place differs from that of the next column, and row (3, 2).
        camera: Of the image.

    Returns:
        Places (4, 4, K) as above, and to which of the 4 E corners each part belongs (K,).
    """
    cells, corners = [], []
    for own in range(4):
        some = np.flatnonzero(depth[own] > 0)
        here, start, half = depth[own, some], place[:, own, some], []
        for axis, bit in enumerate((1, 2)):
            there = depth[own ^ bit, some]
            level = np.append(steps[:, axis], 0)[:, None] * (-1 if own & bit else 1)
            nearest = np.minimum(here, there)
            smooth = (nearest > 0) & (np.abs(here - there) <= edge_step(nearest, camera))
            half.append(np.where(smooth, place[:, own ^ bit, some] - start, level) / 2)
        around = [start, start + half[0], start + half[1], start + half[0] + half[1]]
        cells.append(np.stack([around[own ^ corner] for corner in range(4)], axis=1))
        corners.append(own * depth.shape[1] + some)
    return np.concatenate(cells, axis=2).astype(np.float32), np.concatenate(corners)


def _seen(place: Array, source: NDArray[np.intp], view: Camera) -> tuple[Array, NDArray[np.intp]]:
    """Return what is seen in the middles of a view's pixels: the nearest cell.

    Args:
        place: Of cells' corners (4, 4, K); see `_parts`.
        source: What the corners are (4, K).
        view: To be drawn.

    Returns:
        Depth (H, W) [m], 0 in holes, and the source next to the middle (H, W), -1 in holes.
    """
    ahead = (place[2:] > 0).all(axis=(0, 1))
    place, source = place[:, :, ahead], source[:, ahead]
    flat = place[[0, 1, 3]] / place[2]
    shape = view.height, view.width
    low, high = (
        np.clip(np.ceil(reduce(flat[:2], axis=1)), 0, [[shape[1]], [shape[0]]]).astype(np.intp)
        for reduce in (np.min, np.max)
    )
    across, down = high - low
    # Each cell once for each of the pixels that it may be seen in.
    cell = np.repeat(np.arange(len(across)), across * down)
    number = np.arange(len(cell)) - (np.cumsum(across * down) - across * down)[cell]
    column, row = low[0, cell] + number % across[cell], low[1, cell] + number // across[cell]
    u, v, inverse = flat[:, :, cell]
    u, v = u - column, v - row
    near = np.zeros(len(cell), np.float32)
    for triangle in ((0, 1, 2), (3, 2, 1)):
        # Those of its corners, by the areas of the triangles opposite.
        shares = np.stack([
            u[b] * v[c] - u[c] * v[b]
            for b, c in zip(np.roll(triangle, -1), np.roll(triangle, -2), strict=True)
        ])  # fmt: skip
        inside = np.flatnonzero((shares >= 0).all(axis=0) & (shares.sum(axis=0) > 0))
        shares, corners = shares[:, inside], inverse[:, inside][list(triangle)]
        near[inside] = (shares * corners).sum(axis=0) / shares.sum(axis=0)
    some = np.flatnonzero(near > _at_the_table(view)[row, column])
    # Of all in a pixel the last stays.
    some = some[np.argsort(near[some], kind="stable")]
    depth, found = np.zeros(shape, np.float32), np.full(shape, -1, np.intp)
    pixel = row[some], column[some]
    depth[pixel] = 1 / near[some]
    found[pixel] = source[np.hypot(u, v).argmin(axis=0), cell][some]
    return depth, found


def _at_the_table(view: Camera) -> Floats:
    """Return one over the depth (H, W) beyond which the table hides all from a view, such as floor.

    It is 0 beside the table.
    """
    eye, rays = view.pose[:3, 3], view.directions() @ view.pose[:3, :3].T
    down = np.maximum(-rays[..., 2], 0)
    beside = np.abs(eye[:2] * down[..., None] + eye[2] * rays[..., :2]).max(axis=-1)
    return np.where(beside <= _TABLE_HALF * down, down / (eye[2] + _TABLE_ERROR), 0)


def _shown(vector: Array) -> str:
    return f"({', '.join(f'{number:.3f}' for number in vector.tolist())})"
