"""What a mask network reads of an RGB-D image, and when the mask that it finds counts."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import exp

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import label, uniform_filter

from mechsearch.camera import Camera
from mechsearch.types import Array, Floats, MechSearchError

CHANNELS = 6
"""Of what is seen of an image; see `image_channels`."""

LEAST_CONFIDENCE = 0.5
"""Below it a mask counts as empty: as if nothing of the target were visible."""

_LEAST_PIXELS = 4
"""Of a mask; a smaller one counts as empty too."""

_LARGER = 1.5
"""How many times as large as the first look an image is that is looked at closer."""

_SIDE = 128
"""Of an image in whose pixels the size of a mask counts."""

_LIKELY, _CLOSER = 9, 0.7
"""Side of the window in which a target is likeliest [px]; what the closer look counts of 1."""

_LESS_SURE = 1.0
"""Logit by which the surest pixel of one part of a mask may be less sure than another part's."""

_PIXEL, _HEIGHT = 0.0054, 0.1
"""What becomes 0 or 1 of a pixel's side on the table, and of a height [m]."""


def image_channels(rgb: Array, depth: Array, camera: Camera) -> Array:
    """Return what the network sees of an image (6, H, W) float32.

    These are colours; height over the table; whether depth is known; how large a pixel is there.

    Args:
        rgb: Colours (H, W, 3) uint8.
        depth: Along the optical axis (H, W) [m]; 0 or not finite in holes.
        camera: Where it is believed to be, in a world whose table is at height 0.
    """
    known = (depth > 0) & (depth < np.inf)
    z = np.where(known, depth, 1.0)
    pose = camera.pose
    height = (camera.directions() * z[..., None]) @ pose[2, :3] + pose[2, 3]
    out = np.empty((CHANNELS, *depth.shape), np.float32)
    out[:3] = np.moveaxis(rgb, -1, 0) / np.float32(255) - np.float32(0.5)
    out[3] = np.where(known, np.clip(height / _HEIGHT, -1, 4), 0)
    out[4] = ~known
    out[5] = np.log(z / camera.fx / _PIXEL)
    return out


def at_size(rgb: Array, depth: Array, camera: Camera, longer: int) -> tuple[Array, Array, Camera]:
    """Return an image at another size: colours are averaged, depths are picked.

    Args:
        rgb: Colours; these and what follows as in `image_channels`.
        depth: Depth.
        camera: Camera.
        longer: Longer side that the image is to have [px]; pixels stay as square as they are.
    """
    if longer == max(camera.height, camera.width):
        return rgb, depth, camera
    scale = longer / max(camera.height, camera.width)
    height, width = (max(round(side * scale), 1) for side in (camera.height, camera.width))
    colours = np.asarray(Image.fromarray(rgb).resize((width, height), Image.Resampling.BOX))
    picked = np.ix_(picked_rows(camera.height, height), picked_rows(camera.width, width))
    return colours, depth[picked], camera.resized(height, width)


def picked_rows(old: int, new: int) -> NDArray[np.intp]:
    """Return which rows (new,) of `old` an image of `new` rows has."""
    return ((np.arange(new) + 0.5) * old / new).astype(np.intp)


def logits_by(
    network: Callable[[Array], Array],
    looks: Sequence[int],
    close: int,
    rgb: Array,
    depth: Array,
    camera: Camera,
) -> Array:
    """Return the logits (h, w) of a mask, looked for on the whole image and then closer.

    At the first look the whole image is brought to one size. Where the target is likeliest there, a
    part of an image that is larger is looked at, and counts for more. The longer side of what is
    returned is that of the larger image, or of the first look where the image is hardly larger.

    Args:
        network: Returns logits (G, G) of channels (6, G, G).
        looks: G of the first look and of the part [px].
        close: Longer side of the image that the part is of [px]; smaller ones stay so.
        rgb: Colours; these and what follows as in `image_channels`.
        depth: Depth.
        camera: Camera.
    """
    first, side = looks
    whole = _looked(network, first, *at_size(rgb, depth, camera, first))
    longer = min(close, max(camera.height, camera.width))
    if longer < _LARGER * first:
        return whole
    colours, depths, finer = at_size(rgb, depth, camera, longer)
    logits = np.array(
        Image.fromarray(whole).resize((finer.width, finer.height), Image.Resampling.BILINEAR)
    )
    likely = uniform_filter(1 / (1 + np.exp(-logits)), _LIKELY)
    middle = np.unravel_index(int(likely.argmax()), likely.shape)
    top, left = (
        int(np.clip(at - side // 2, 0, max(size - side, 0)))
        for at, size in zip(middle, logits.shape, strict=True)
    )
    part = slice(top, top + side), slice(left, left + side)
    height, width = depths[part].shape
    near = replace(finer, height=height, width=width, cx=finer.cx - left, cy=finer.cy - top)
    found = _looked(network, side, colours[part], depths[part], near)
    logits[part] += _CLOSER * (found - logits[part])
    return logits


def _looked(
    network: Callable[[Array], Array], side: int, rgb: Array, depth: Array, camera: Camera
) -> Array:
    """Return the logits (H, W) on an image that the grid has room for."""
    seen = image_channels(rgb, depth, camera)
    if depth.shape == (side, side):
        return network(seen)
    framed = np.zeros((CHANNELS, side, side), np.float32)
    framed[:, : camera.height, : camera.width] = seen
    return network(framed)[: camera.height, : camera.width]


def surest_parts(logits: Array) -> NDArray[np.bool_]:
    """Return where logits (H, W) are above 0, without separate parts that are clearly less sure.

    A target of which several parts are seen looks as sure in each; what is less sure is mostly
    another object of its colours.
    """
    inside = logits > 0
    parts, count = label(inside, np.ones((3, 3)))
    most = np.full(count + 1, -np.inf)
    np.maximum.at(most, parts[inside], logits[inside])
    return np.asarray(inside & (most >= most.max() - _LESS_SURE)[parts])


def mask_features(logits: Array, mask: NDArray[np.bool_]) -> Floats:
    """Return from what a mask's confidence is computed (2,).

    They are the logit of the expected IoU, and the logarithm of the size in pixels of an image
    whose longer side is 128.

    Args:
        logits: Of a mask (H, W).
        mask: Its `surest_parts`.
    """
    chance = 1 / (1 + np.exp(-np.clip(logits, -30, 30).astype(np.float64)))
    size = int(mask.sum())
    if not size:
        return np.array([-6.0, 0.0])
    share = np.clip(chance[mask].sum() / (size + chance[~mask].sum()), 1e-3, 1 - 1e-3)
    pixel = _SIDE / max(logits.shape)
    return np.array([np.log(share / (1 - share)), np.log(size * pixel**2)])


def mask_of(
    logits: Array, weights: Sequence[float], camera: Camera
) -> tuple[NDArray[np.bool_], float]:
    """Return the mask (H, W) that logits are, and how sure it is, in [0, 1].

    Args:
        logits: On the network's grid (h, w), from `logits_by`.
        weights: Of `mask_features` and 1 in the confidence, (3,).
        camera: Of the image, which may be larger or smaller.
    """
    mask = surest_parts(logits)
    features = (*mask_features(logits, mask).tolist(), 1.0)
    chance = sum(weight * value for weight, value in zip(weights, features, strict=True))
    if logits.shape != (size := (camera.height, camera.width)):
        finer = Image.fromarray(logits).resize(size[::-1], Image.Resampling.BILINEAR)
        mask = surest_parts(np.asarray(finer))
    return mask, 1 / (1 + exp(-min(max(chance, -30.0), 30.0)))


def check_seen(rgb: Array, depth: Array, camera: Camera) -> None:
    """Refuse what is no RGB-D image of a camera.

    Raises:
        MechSearchError: If colours, depth and camera differ in size, or the depth is holes alone.
    """
    shape = (camera.height, camera.width)
    if depth.shape != shape or rgb.shape != (*shape, 3) or rgb.dtype != np.uint8:
        raise MechSearchError(
            f"colours {rgb.shape} of {rgb.dtype.name} and depth {depth.shape}; expected uint8 and "
            f"the camera's {shape}"
        )
    if not ((depth > 0) & (depth < np.inf)).any():
        raise MechSearchError("depth is holes alone, 0 or not finite; expected metres")


def counted(
    mask: NDArray[np.bool_], confidence: float, least: float = LEAST_CONFIDENCE
) -> NDArray[np.bool_]:
    """Return a mask, empty if its confidence is less than `least`, or fewer than 4 are in it."""
    if confidence < least or mask.sum() < _LEAST_PIXELS:
        return np.zeros(mask.shape, np.bool_)
    return mask
