"""What all pictures share: heaps with a green target, type, captions, and rows of pictures."""

from collections.abc import Sequence
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from scipy import ndimage

from mechsearch.camera import Camera, look_at
from mechsearch.render.renderer import PUSHER, Frame, Renderer
from mechsearch.types import Array, MechSearchError

SMOOTHING = 2
"""Pictures are rendered so many times larger than they are shown."""

SIDES = (16, 2048)
"""Least and greatest side of a picture [px]."""

WHITE, INK = (255, 255, 255), (32, 36, 44)
_SOFT = (110, 116, 126)
_TINT, _RIM = (40, 215, 70), (0, 90, 30)


_LAMP = Camera(
    512, 512, 560.0, 560.0, 255.5, 255.5, look_at((0.75, 0.55, 1.15), (0.0, 0.0, 0.0), (0, 1, 0))
)
"""A view from the lamp: what it does not see lies in shade. High things throw it to a side, so that
it shows how high they are."""

_NEAR = ((0, 0), (1, 1), (-2, 0), (0, -2), (2, -1), (-1, 3), (3, 1), (-3, -1), (1, -3), (0, 2))
"""Pixels about a point's own in the lamp's view, whose mean makes the edges of shadows soft."""

_MARGIN = 4
"""Pixels about the lamp's view, so that none of those is beyond it."""

_BIAS = 0.009
"""How much farther than the light goes a point must be to lie in shade [m]."""


def tinted(rgb: NDArray[np.uint8], mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return the image (H, W, 3) with the pixels of a mask (H, W) green, and no others.

    The others are paler, and what is green among them turns grey, yellow or blue. Shading is kept.
    A dark rim in a white one marks the mask for who does not see green, or prints in grey.
    """
    light = rgb.mean(axis=2, keepdims=True)
    result = 0.5 * rgb + 0.5 * light
    red, green, blue = np.moveaxis(result, -1, 0)
    np.minimum(green, np.where(red < blue, (red + blue) / 2, red), out=green)
    result *= light / np.maximum(result.mean(axis=2, keepdims=True), 1)
    green = np.array(_TINT) * (0.55 + 0.65 * light[mask] / 255)
    result[mask] = 0.1 * rgb[mask] + 0.9 * green
    width = max(1, len(mask) // 200)
    inner = ndimage.binary_erosion(mask, iterations=width, border_value=1)
    result[mask & ~np.asarray(inner, np.bool_)] = _RIM
    outer = ndimage.binary_dilation(mask, iterations=2 * width)
    result[np.asarray(outer, np.bool_) & ~mask] = WHITE
    return np.asarray(np.clip(result, 0, 255), np.uint8)


def photographed(
    renderer: Renderer, camera: Camera, poses: Array, target: int, pusher: Array | None = None
) -> Image.Image:
    """Return a heap with its target tinted, lit from a side, and a note where the frame cuts it.

    See `Renderer.frame`.
    """
    frame = renderer.frame(camera, poses, pusher, colour=True)
    assert frame.rgb is not None
    light = _lamplight(camera, frame, renderer.frame(_LAMP, poses, pusher).depth)
    lit = tinted(frame.rgb, frame.modal(target)) * light[..., None]
    image = Image.fromarray(np.clip(lit, 0, 255).astype(np.uint8))
    whole = frame.amodal[target]
    if whole[[0, -1]].any() or whole[:, [0, -1]].any():
        _note(image, "target partly out of view")
    elif not whole.any():
        _note(image, "target out of view")
    return image


def _lamplight(camera: Camera, frame: Frame, reached: NDArray[np.float32]) -> Array:
    """Return how bright each pixel (H, W) is: in the lamp's light, in shade, in a corner.

    Args:
        camera: Of the picture.
        frame: The picture.
        reached: How far the lamp's light goes (S, S) [m], by pixel of `_LAMP`.
    """
    # Light is so smooth that every second pixel will do.
    rows, columns = np.mgrid[: camera.height : SMOOTHING, : camera.width : SMOOTHING]
    seen = frame.depth[::SMOOTHING, ::SMOOTHING]
    points = camera.points_at(columns, rows, seen)
    places = _LAMP.project(points)
    # Beyond the lamp's view all is light.
    far = np.pad(np.where(reached > 0, reached, np.inf), _MARGIN, constant_values=np.inf)
    inside = np.clip(np.round(places[..., :2]), -1, _LAMP.height).astype(np.intp) + _MARGIN
    index, away = inside[..., 1] * len(far) + inside[..., 0], places[..., 2] - _BIAS
    shade = sum((away > far.ravel()[index + down * len(far) + across]) for across, down in _NEAR)
    # What is lower than its surroundings gets less light from the sky, the robot left out.
    robot = frame.ids[::SMOOTHING, ::SMOOTHING] == PUSHER
    height = np.clip(points[..., 2], -0.02, 0.12) * ~robot
    around = ndimage.gaussian_filter(height, camera.height / SMOOTHING / 40)
    corner = np.clip((around - height) / 0.04, 0, 1) * ~robot
    light = np.where(seen > 0, 1.06 - 0.36 * shade / len(_NEAR) - 0.3 * corner, 1.0)
    whole = light.astype(np.float32).repeat(SMOOTHING, axis=0).repeat(SMOOTHING, axis=1)
    return np.asarray(whole[: camera.height, : camera.width])


def _note(image: Image.Image, words: str) -> None:
    """Write on a picture, in its lower left corner."""
    text = max(11 * SMOOTHING, image.height // 20)
    place = (text // 3, image.height - text // 3)
    draw, font = ImageDraw.Draw(image), _font(text)
    draw.rectangle(draw.textbbox(place, words, font, "ld"), fill=WHITE)
    draw.text(place, words, INK, font, "ld")


@cache
def typeface() -> Path | None:
    """Return the file of DejaVu, which Matplotlib brings; without that, None."""
    if find_spec("matplotlib") is None:
        return None
    return Path(import_module("matplotlib").get_data_path(), "fonts", "ttf", "DejaVuSans.ttf")


@cache
def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    found = typeface()
    return ImageFont.truetype(found, size) if found else ImageFont.load_default(size)


@cache
def _glyphs() -> frozenset[int]:
    """Return the characters of the typeface; of Pillow's own those of western Europe."""
    found = typeface()
    if found is None:
        return frozenset((*range(32, 127), *range(160, 256)))
    return frozenset(import_module("matplotlib.ft2font").FT2Font(str(found)).get_charmap())


def legible(text: str) -> str:
    r"""Return a text with characters that its typeface lacks as escapes, such as \u676f."""
    return "".join(
        c if ord(c) in _glyphs() or c.isspace() else c.encode("unicode_escape").decode()
        for c in text
    )


def check_side(size: int) -> None:
    """Refuse pictures too small to be seen, or too large for a computer's memory.

    Args:
        size: Their side [px].

    Raises:
        MechSearchError: If it is out of range.
    """
    least, most = SIDES
    if not least <= size <= most:
        raise MechSearchError(f"a size of {size} px; expected {least} to {most}")


def shrunk(image: Image.Image, size: int) -> Image.Image:
    """Return a square picture at the size [px] at which it is shown."""
    return image.resize((size, size), Image.Resampling.LANCZOS)


def captioned(image: Image.Image, *lines: str, text: int) -> Image.Image:
    """Return a picture with lines of `text` [px] below it, cut off where they are too long."""
    height = image.height + round((0.7 + 1.3 * len(lines)) * text)
    framed = Image.new("RGB", (image.width, height), WHITE)
    framed.paste(image, (0, 0))
    # DejaVu is large for its size.
    draw, font = ImageDraw.Draw(framed), _font(round(0.88 * text))
    for i, line in enumerate(lines):
        words = legible(line)
        while draw.textlength(words, font=font) > image.width - 2 and len(words) > 4:
            words = words[:-2].rstrip("…") + "…"
        place = (2, image.height + text * (0.2 + 1.3 * i))
        draw.text(place, words, fill=_SOFT if i else INK, font=font)
    return framed


def tiled(
    pictures: Sequence[Image.Image], columns: int, gap: int = 6, margin: int = 0
) -> Image.Image:
    """Return pictures in rows of `columns`, `gap` [px] apart and `margin` [px] from the edge."""
    columns = max(1, min(columns, len(pictures)))
    widths = [max(one.width for one in pictures[i::columns]) for i in range(columns)]
    rows = [pictures[i : i + columns] for i in range(0, len(pictures), columns)]
    heights = [max(one.height for one in row) for row in rows]
    width, height = (sum(s) + gap * (len(s) - 1) + 2 * margin for s in (widths, heights))
    sheet = Image.new("RGB", (width, height), WHITE)
    for r, row in enumerate(rows):
        for c, one in enumerate(row):
            left, top = sum(widths[:c]) + gap * c, sum(heights[:r]) + gap * r
            sheet.paste(one, (left + margin, top + margin))
    return sheet
