"""Reference views of a target: rendered from its mesh, or a user's photographs with masks."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from mechsearch.camera import Camera, look_at
from mechsearch.objects.model import ObjectModel
from mechsearch.render.visibility import NO_HIT, body_of
from mechsearch.types import Array, Floats, MechSearchError

GRID, FULL = 128, 256
"""Sides of the images on which objects are looked for [px]: at the first look about, and when
looking closer at a part."""

LOOKS = 112, 128
"""Sides of the whole image at the first look, and of the part of an image of `FULL` px that is
then looked at closer [px]; more of either takes more time and finds hardly more."""

SIDE = 40
"""Of a reference view, which is as large as the object in it [px]."""

_LEAST_PIXELS = 16
"""Of a mask in an image of one's own, below which nothing can be told from it."""

_RENDERED, _MARGIN, _APART = 96, 1.05, 8.0
"""Side of an image that a view is cut out of [px]; how much wider than the object views are; how
many of its radii the camera is away, so that sizes on an image are the same all over."""


@dataclass(frozen=True, eq=False)
class References:
    """Views of one object (V,), each cut out about it.

    Attributes:
        rgb: Colours (V, S, S, 3) uint8, 0 beside the object; S is `SIDE`.
        mask: Where the object is (V, S, S) bool.
        width: Of what each view shows, at the object (V,) [m]; 0 where it is not known, as of
            photographs from no known distance.
    """

    rgb: NDArray[np.uint8]
    mask: NDArray[np.bool_]
    width: NDArray[np.float32]


def directions(count: int = 12) -> Floats:
    """Return unit vectors (count, 3), evenly spread over the sphere (Fibonacci)."""
    steps = np.arange(count) + 0.5
    height, angle = 1 - 2 * steps / count, np.pi * (1 + np.sqrt(5)) * steps
    around = np.sqrt(1 - height**2)
    return np.stack([around * np.cos(angle), around * np.sin(angle), height], axis=1)


def render_references(model: ObjectModel, views: Floats | None = None) -> References:
    """Return views of an object from its mesh, turned about the line of sight at will.

    Args:
        model: The object.
        views: Directions (V, 3) from which it is seen, in its own frame; `directions` by default.
    """
    body, radius = body_of(model), model.radius
    focal = _RENDERED / 2 * _APART / _MARGIN
    middle, still = (_RENDERED - 1) / 2, np.eye(3, dtype=np.float32)
    images, masks = [], []
    for number, view in enumerate(directions() if views is None else views):
        up = np.roll(view, 1) + np.array([0.1, 0.2 * number, 0.3])
        pose = look_at(_APART * radius * view, (0, 0, 0), up)
        camera = Camera(_RENDERED, _RENDERED, focal, focal, middle, middle, pose)
        rays = (camera.directions().reshape(-1, 3) @ camera.pose[:3, :3].T).astype(np.float32)
        start = camera.pose[:3, 3]
        mask = body.depths(start, rays, still) < NO_HIT
        rgb = np.zeros((_RENDERED**2, 3), np.uint8)
        rgb[mask] = body.colours(start, rays[mask], still)
        images.append(rgb.reshape(_RENDERED, _RENDERED, 3))
        masks.append(mask.reshape(_RENDERED, _RENDERED))
    return cut_out(images, masks, [_APART * radius / focal] * len(images))


def cut_out(
    images: Sequence[Array], masks: Sequence[Array], pixels: Sequence[float] | None = None
) -> References:
    """Return the reference views that photographs and their masks are.

    Args:
        images: Colours (H, W, 3) uint8 of each, of any size.
        masks: Where the object is (H, W) bool on each.
        pixels: Side of a pixel at the object [m], where it is known; it tells cups of several
            sizes apart.

    Raises:
        MechSearchError: If there is no view, one has no mask or a mask of another size, or a mask
            has less than 16 pixels.
    """
    if not len(images) or len(masks) != len(images):
        raise MechSearchError(
            f"{len(images)} reference views and {len(masks)} masks; expected at least one view, "
            "and a mask for each"
        )
    rgb, mask, width = [], [], []
    for number, (image, own) in enumerate(zip(images, masks, strict=True)):
        view, inside = np.asarray(image), np.asarray(own, np.bool_)
        if view.dtype != np.uint8 or view.ndim != 3 or view.shape != (*inside.shape, 3):
            raise MechSearchError(
                f"reference view {number} is {view.shape} of {view.dtype.name} with a mask "
                f"{inside.shape}; expected (H, W, 3) of uint8 and (H, W)"
            )
        if inside.sum() < _LEAST_PIXELS:
            raise MechSearchError(
                f"the mask of reference view {number} has {inside.sum()} pixels; expected at "
                f"least {_LEAST_PIXELS}, where the object is"
            )
        rows, columns = (np.flatnonzero(inside.any(axis=axis)) for axis in (1, 0))
        side = max(rows[-1] - rows[0], columns[-1] - columns[0]) + 1
        side *= _MARGIN
        top, left = (rows[0] + rows[-1] + 1 - side) / 2, (columns[0] + columns[-1] + 1 - side) / 2
        box = (left, top, left + side, top + side)
        # The background is black before anything is mixed, and mixed out again.
        alpha = _resized(255 * inside.astype(np.uint8), box) / 255
        seen = (
            _resized(np.where(inside[..., None], view, 0), box) / np.maximum(alpha, 0.02)[..., None]
        )
        inside = alpha >= 0.5
        rgb.append(np.where(inside[..., None], np.clip(seen, 0, 255), 0).astype(np.uint8))
        mask.append(inside)
        width.append(side * pixels[number] if pixels is not None else 0.0)
    return References(np.array(rgb), np.array(mask), np.array(width, np.float32))


def _resized(image: Array, box: tuple[float, float, float, float]) -> Floats:
    """Return a square cut out of an image, which may reach beyond it, at `SIDE` pixels."""
    left, top = floor(box[0]), floor(box[1])
    cut = Image.fromarray(image).crop((left, top, ceil(box[2]), ceil(box[3])))
    moved = (box[0] - left, box[1] - top, box[2] - left, box[3] - top)
    return np.asarray(cut.resize((SIDE, SIDE), Image.Resampling.BOX, moved), np.float64)
