"""What all pictures share: heaps with a green target, captions, and rows of pictures."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from scipy import ndimage

from mechsearch.camera import Camera
from mechsearch.render.renderer import Renderer
from mechsearch.types import Array

SMOOTHING = 2
"""Pictures are rendered so many times larger than they are shown."""

WHITE, INK = (255, 255, 255), (32, 36, 44)
_SOFT = (110, 116, 126)
_TINT, _RIM = (40, 215, 70), (0, 90, 30)


def tinted(rgb: NDArray[np.uint8], mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return the image (H, W, 3) with the pixels of a mask (H, W) green and all others paler.

    Shading is kept, and a dark rim sets the target apart from other green things.
    """
    light = rgb.mean(axis=2, keepdims=True)
    result = 0.5 * rgb + 0.5 * light
    green = np.array(_TINT) * (0.55 + 0.65 * light[mask] / 255)
    result[mask] = 0.1 * rgb[mask] + 0.9 * green
    inner = ndimage.binary_erosion(mask, iterations=max(1, len(mask) // 280), border_value=1)
    result[mask & ~np.asarray(inner, np.bool_)] = _RIM
    return np.asarray(np.clip(result, 0, 255), np.uint8)


def photographed(
    renderer: Renderer, camera: Camera, poses: Array, target: int, pusher: Array | None = None
) -> Image.Image:
    """Return a heap with its target tinted; see `Renderer.frame`."""
    frame = renderer.frame(camera, poses, pusher, colour=True)
    assert frame.rgb is not None
    return Image.fromarray(tinted(frame.rgb, frame.modal(target)))


def shrunk(image: Image.Image, size: int) -> Image.Image:
    """Return a square picture at the size [px] at which it is shown."""
    return image.resize((size, size), Image.Resampling.LANCZOS)


def captioned(image: Image.Image, *lines: str, text: int) -> Image.Image:
    """Return a picture with lines of `text` [px] below it, cut off where they are too long."""
    height = image.height + round((0.7 + 1.3 * len(lines)) * text)
    framed = Image.new("RGB", (image.width, height), WHITE)
    framed.paste(image, (0, 0))
    draw, font = ImageDraw.Draw(framed), ImageFont.load_default(text)
    for i, line in enumerate(lines):
        words = line
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
