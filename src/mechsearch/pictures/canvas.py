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

from mechsearch.camera import Camera
from mechsearch.render.renderer import Renderer
from mechsearch.types import Array, MechSearchError

SMOOTHING = 2
"""Pictures are rendered so many times larger than they are shown."""

SIDES = (16, 2048)
"""Least and greatest side of a picture [px]."""

WHITE, INK = (255, 255, 255), (32, 36, 44)
_SOFT = (110, 116, 126)
_TINT, _RIM = (40, 215, 70), (0, 90, 30)


def tinted(rgb: NDArray[np.uint8], mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return the image (H, W, 3) with the pixels of a mask (H, W) green, and no others.

    The others are paler, and what is green among them turns grey, yellow or blue. Shading is kept.
    """
    light = rgb.mean(axis=2, keepdims=True)
    result = 0.5 * rgb + 0.5 * light
    red, green, blue = np.moveaxis(result, -1, 0)
    np.minimum(green, np.where(red < blue, (red + blue) / 2, red), out=green)
    result *= light / np.maximum(result.mean(axis=2, keepdims=True), 1)
    green = np.array(_TINT) * (0.55 + 0.65 * light[mask] / 255)
    result[mask] = 0.1 * rgb[mask] + 0.9 * green
    inner = ndimage.binary_erosion(mask, iterations=max(1, len(mask) // 280), border_value=1)
    result[mask & ~np.asarray(inner, np.bool_)] = _RIM
    return np.asarray(np.clip(result, 0, 255), np.uint8)


def photographed(
    renderer: Renderer, camera: Camera, poses: Array, target: int, pusher: Array | None = None
) -> Image.Image:
    """Return a heap with its target tinted, and a note where the frame cuts it.

    See `Renderer.frame`.
    """
    frame = renderer.frame(camera, poses, pusher, colour=True)
    assert frame.rgb is not None
    image = Image.fromarray(tinted(frame.rgb, frame.modal(target)))
    whole = frame.amodal[target]
    if whole[[0, -1]].any() or whole[:, [0, -1]].any():
        _note(image, "target partly out of view")
    elif not whole.any():
        _note(image, "target out of view")
    return image


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
