"""Brings the images of any calibrated camera into the view that a policy knows."""

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mechsearch.camera import Camera
from mechsearch.observe.observation import check_metres, measured_pixels
from mechsearch.types import Array, Floats, MechSearchError

_MOST_SAMPLES = 8
"""Along a pixel's side, in a view that is denser than the image."""

_TABLE_HALF, _TABLE_ERROR = 0.4, 0.03
"""Half the side of the table, and how far below it a point of it may be measured [m]."""


@dataclass(frozen=True)
class Reprojection:
    """What one camera would have seen, as far as another one saw it.

    Attributes:
        depth: (H, W) float32 [m], 0 in holes: where the other camera saw nothing.
        mask: (H, W) bool, false in holes; None if none was given.
        colour: (H, W, 3) uint8, 0 in holes; None if none was given.
    """

    depth: Array
    mask: Array | None
    colour: Array | None


def reproject(
    depth: Any, camera: Camera, view: Camera, mask: Any = None, colour: Any = None
) -> Reprojection:
    """Return the images of any calibrated camera in the view that a policy knows.

    Surfaces are sampled densely enough for the view, between pixels too unless there is an edge; of
    what falls into one of its pixels the nearest surface prevails, sampled next to the middle.
    Holes are left to `without_holes`, as of any camera.

    Args:
        depth: (H, W), floating-point numbers [m]; holes as in `without_holes`, in any number.
        camera: Intrinsics and pose of that image.
        view: Of the policy, such as `camera.preset(policy.camera, policy.image_size)`.
        mask: Pixels of the target (H, W) bool in the same image.
        colour: (H, W, 3) uint8, likewise.

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
    near, found = _into(np.where(measured, image, 0).astype(np.float64), camera, view)
    if not (found >= 0).any():
        raise MechSearchError(
            f"nothing that the camera at {_shown(place)} m sees is in the view of the policy's "
            f"camera at {_shown(view.pose[:3, 3])} m; expected both to see the table"
        )
    holes = found < 0

    def taken(values: Any, kind: Any) -> Array | None:
        if values is None:
            return None
        array = np.asarray(values, kind)
        picked: Array = array.reshape(-1, *array.shape[2:])[found]
        picked[holes] = 0
        return picked

    return Reprojection(near, taken(mask, np.bool_), taken(colour, np.uint8))


def _into(depth: Floats, camera: Camera, view: Camera) -> tuple[Array, NDArray[np.intp]]:
    """Return depth (H, W) [m] in a view, 0 in holes, and the pixel seen there; -1 in holes."""
    inverse = np.divide(1.0, depth, out=np.zeros_like(depth), where=depth > 0)
    # A pixel with its neighbours on the right, below, and beyond: one over depth is linear in it.
    padded = np.pad(inverse, ((0, 1), (0, 1)))
    corners = np.stack([padded[:-1, :-1], padded[:-1, 1:], padded[1:, :-1], padded[1:, 1:]])
    low = corners.min(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        smooth = (low > 0) & (1 / low - 1 / corners.max(axis=0) <= edge_step(depth, camera))
    pixels = np.flatnonzero(inverse)
    pixels = pixels[~_under_the_table(pixels, depth.ravel()[pixels], camera, view)]
    between, around = smooth.ravel()[pixels], corners.reshape(4, -1)[:, pixels]
    onto = np.linalg.inv(view.pose) @ camera.pose
    times = _samples(onto, pixels[between], around[:, between], camera, view)
    reach = _in_reach(onto, pixels, around, between, camera, view)
    pixels, around, between = pixels[reach], around[:, reach], between[reach]
    best = np.full(view.width * view.height, np.inf)
    fallen = []
    for a, b in product(np.arange(times) / times, repeat=2):
        use = between if a or b else np.ones(len(pixels), np.bool_)
        weights = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
        z = 1 / sum(w * one[use] for w, one in zip(weights, around, strict=True))
        u, v, z = _projected(_placed(onto, pixels[use], z, camera, a, b), view)
        seen = (z > 0) & (np.abs(u - (view.width - 1) / 2) < view.width / 2)
        seen &= np.abs(v - (view.height - 1) / 2) < view.height / 2
        u, v, z = u[seen], v[seen], z[seen]
        place = np.rint(v).astype(np.intp) * view.width + np.rint(u).astype(np.intp)
        np.minimum.at(best, place, z)
        source = pixels[use][seen] + (a >= 0.5) + (b >= 0.5) * camera.width
        fallen.append((place, z, source, np.hypot(u - np.rint(u), v - np.rint(v))))
    place, z, source, away = map(np.concatenate, zip(*fallen, strict=True))
    front = z <= best[place] + edge_step(best[place], view)
    place, z, source, away = place[front], z[front], source[front], away[front]
    # The one next to a place's middle is written; the last, where several are.
    middle = np.full(len(best), np.inf)
    np.minimum.at(middle, place, away)
    next_to = away == middle[place]
    found, near = np.full(len(best), -1, np.intp), np.zeros(len(best), np.float32)
    found[place[next_to]], near[place[next_to]] = source[next_to], z[next_to]
    shape = (view.height, view.width)
    return near.reshape(shape), found.reshape(shape)


def _in_reach(
    onto: Floats, pixels: Array, around: Floats, between: Array, camera: Camera, view: Camera
) -> Array:
    """Return which pixels (K,) may be seen in a view: no side of it has all their corners."""
    u, v, z = _projected(_placed(onto, pixels, 1 / around[0], camera), view)
    seen = np.ones(len(pixels), np.bool_)
    for place, length in ((u, view.width), (v, view.height)):
        off = place - (length - 1) / 2
        # Below and after the last pixel there is room for what is next to it.
        beyond = np.zeros((camera.height + 2, camera.width), np.int8)
        beyond.ravel()[pixels] = np.where((z > 0) & (np.abs(off) > length / 2), np.sign(off), 0)
        corners = (beyond.ravel()[pixels + at] for at in (0, 1, camera.width, camera.width + 1))
        own, *others = corners
        seen &= np.where(between, np.abs(own + sum(others)) < 4, own == 0)
    return seen


def _placed(
    onto: Floats, pixels: Array, depth: Floats, camera: Camera, right: float = 0, down: float = 0
) -> list[Floats]:
    """Return x, y and z (K,) in another frame of points beside pixels, by their flat indices."""
    x = (pixels % camera.width + right - camera.cx) / camera.fx
    y = (pixels // camera.width + down - camera.cy) / camera.fy
    # Not as a product of matrices: on a busy machine, threads for so narrow ones are slow.
    return [depth * (row[0] * x + row[1] * y + row[2]) + row[3] for row in onto[:3]]


def _projected(place: list[Floats], view: Camera) -> tuple[Floats, Floats, Floats]:
    """Return column, row [px] and depth of points in a camera's frame."""
    x, y, z = place
    ahead = np.where(z > 0, z, 1.0)
    return view.fx * x / ahead + view.cx, view.fy * y / ahead + view.cy, z


def _under_the_table(pixels: Array, depth: Floats, camera: Camera, view: Camera) -> Array:
    """Return which pixels show what the table hides from a view, such as the floor beside it."""
    x, y, z = _placed(camera.pose, pixels, depth, camera)
    eye = view.pose[:3, 3]
    share = eye[2] / np.maximum(eye[2] - z, 1e-9)
    over = np.maximum(np.abs(eye[0] + share * (x - eye[0])), np.abs(eye[1] + share * (y - eye[1])))
    hidden: Array = (z < -_TABLE_ERROR) & (over <= _TABLE_HALF)
    return hidden


def edge_step(depth: Floats, camera: Camera) -> Floats:
    """Return the least difference in depth between neighbours that is an edge (H, W) [m].

    It is more than 5 mm, and than that of a surface of slope 2 against the image plane, about 63
    degrees.
    """
    return 0.005 + 2.0 * depth / camera.fx


def _samples(onto: Floats, pixels: Array, around: Floats, camera: Camera, view: Camera) -> int:
    """Return how many samples a pixel's side needs so that none of a view's pixels is passed over.

    Args:
        onto: From the camera's frame to that of the view.
        pixels: Flat indices (K,) of pixels on smooth surfaces.
        around: One over depth (4, K) of them, the next ones right and below, and a fourth.
        camera: Of these.
        view: Where they are to be seen.
    """
    some = slice(None, None, max(1, len(pixels) // 1000))
    here, right, below = (
        np.array(_projected(_placed(onto, pixels[some], 1 / one[some], camera, *at), view))
        for one, at in zip(around, ((0, 0), (1, 0), (0, 1)), strict=False)
    )
    apart = np.hypot(*(np.stack([right, below], axis=1)[:2] - here[:2, None]))[:, here[2] > 0]
    # Squares of this side lie over every pixel, however they are turned.
    widest = float(np.quantile(apart, 0.99)) * np.sqrt(2) if apart.size else 1.0
    return int(np.clip(np.ceil(widest), 1, _MOST_SAMPLES))


def _shown(vector: Array) -> str:
    return f"({', '.join(f'{number:.3f}' for number in vector.tolist())})"
