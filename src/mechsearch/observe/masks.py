"""What a mask network reads of an RGB-D image, and when the mask that it finds counts."""

from collections.abc import Callable, Sequence
from math import exp

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import label, maximum

from mechsearch.camera import Camera
from mechsearch.types import Array, Floats, MechSearchError

CHANNELS = 6
"""Of what is seen of an image; see `image_channels`."""

LEAST_CONFIDENCE = 0.5
"""Below it a mask counts as empty: as if nothing of the target were visible."""

_LEAST_PIXELS = 4
"""Of a mask; a smaller one counts as empty too."""

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


def logits_by(
    network: Callable[[Array], Array], side: int, rgb: Array, depth: Array, camera: Camera
) -> Array:
    """Return the logits (h, w) of a mask on a network's own grid, whose longer side is G.

    Args:
        network: Returns logits (G, G) of channels (6, G, G).
        side: Of its grid, G [px].
        rgb: Colours; these and what follows as in `image_channels`.
        depth: Depth.
        camera: Camera.
    """
    if (camera.height, camera.width) == (side, side):
        return network(image_channels(rgb, depth, camera))
    # The longer side fills the grid, so that pixels stay square.
    scale = side / max(camera.height, camera.width)
    height, width = (max(round(side * scale), 1) for side in (camera.height, camera.width))
    rows, columns = (
        ((np.arange(new) + 0.5) * old / new).astype(np.intp)
        for new, old in ((height, camera.height), (width, camera.width))
    )
    colours = np.asarray(Image.fromarray(rgb).resize((width, height), Image.Resampling.BOX))
    small = camera.resized(height, width)
    seen = np.zeros((CHANNELS, side, side), np.float32)
    seen[:, :height, :width] = image_channels(colours, depth[np.ix_(rows, columns)], small)
    return network(seen)[:height, :width]


def surest_parts(logits: Array) -> NDArray[np.bool_]:
    """Return where logits (H, W) are above 0, without separate parts that are clearly less sure.

    A target of which several parts are seen looks as sure in each; what is less sure is mostly
    another object of its colours.
    """
    inside = logits > 0
    parts, count = label(inside, np.ones((3, 3)))
    most = maximum(logits, parts, np.arange(count + 1))
    return np.asarray(inside & (most >= most.max() - _LESS_SURE)[parts])


def mask_features(logits: Array) -> Floats:
    """Return from what a mask's confidence is computed (2,): expected IoU and size, as logits."""
    chance = 1 / (1 + np.exp(-np.clip(logits, -30, 30).astype(np.float64)))
    inside = surest_parts(logits)
    size = int(inside.sum())
    if not size:
        return np.array([-6.0, 0.0])
    share = np.clip(chance[inside].sum() / (size + chance[~inside].sum()), 1e-3, 1 - 1e-3)
    return np.array([np.log(share / (1 - share)), np.log(size)])


def mask_of(
    logits: Array, weights: Sequence[float], camera: Camera
) -> tuple[NDArray[np.bool_], float]:
    """Return the mask (H, W) that logits are, and how sure it is, in [0, 1].

    Args:
        logits: On the network's grid (h, w), from `logits_by`.
        weights: Of `mask_features` and 1 in the confidence, (3,).
        camera: Of the image, which may be larger or smaller.
    """
    features = (*mask_features(logits).tolist(), 1.0)
    chance = sum(weight * value for weight, value in zip(weights, features, strict=True))
    if logits.shape != (size := (camera.height, camera.width)):
        finer = Image.fromarray(logits).resize(size[::-1], Image.Resampling.BILINEAR)
        logits = np.asarray(finer)
    return surest_parts(logits), 1 / (1 + exp(-min(max(chance, -30.0), 30.0)))


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
