"""One picture of an object set: every object with its name, mass, size and convex parts."""

import textwrap
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from mechsearch.camera import Camera, look_at
from mechsearch.objects.limits import FLAGGED_ERROR
from mechsearch.objects.model import ObjectModel, ObjectSet
from mechsearch.render.renderer import BACKGROUND, Renderer
from mechsearch.runs import write_whole
from mechsearch.types import MechSearchError

SMALLEST_TILE = 96

_LINE = 15
_MARGIN = 12
_OVERSAMPLING = 3
_PAPER, _INK, _FAINT, _RED = "white", "#1c1c1e", "#6b6b70", "#c62828"
_TILE = np.array([240, 240, 238], np.uint8)
_VIEW = np.array([0.55, -1.0, 0.85]) / np.linalg.norm([0.55, -1.0, 0.85])
_FILL = 0.9  # Of the tile, by the longer side of the object's outline.
_DISTANCE = 5.0  # In radii of the object: far enough for little perspective.


def contact_sheet(objects: ObjectSet, path: Path, columns: int = 8, size: int = 160) -> None:
    """Draw every object of a set in a tile of its own, and list the excluded ones below.

    Objects fill their tiles, so tiles differ in scale; the sizes are written under them. A hull
    error large enough to be flagged is written in red.

    Args:
        objects: The set.
        path: Where the PNG goes; an existing file is replaced as a whole.
        columns: Tiles in a row.
        size: Side of a tile [px], at least 96.

    Raises:
        MechSearchError: If a number is too small or the path does not end in ".png".
    """
    if columns < 1 or size < SMALLEST_TILE:
        raise MechSearchError(
            f"a contact sheet of {columns} columns of {size} px cannot be drawn; "
            f"expected at least 1 column of {SMALLEST_TILE} px"
        )
    if path.suffix.lower() != ".png":
        raise MechSearchError(f"the contact sheet {path} is a PNG; expected a name in .png")
    sheet = draw_sheet(objects, columns, size)
    write_whole(path, lambda partial: sheet.save(partial, format="PNG"))


def draw_sheet(objects: ObjectSet, columns: int, size: int) -> Image.Image:
    """Return the contact sheet as an image; see `contact_sheet`."""
    models = list(objects.models.values())
    columns = max(1, min(columns, len(models)))
    width = 2 * _MARGIN + columns * (size + _MARGIN) - _MARGIN
    notes = _excluded_lines(objects, width)
    tile_height = size + 3 * _LINE + _MARGIN
    top = _MARGIN + 2 * _LINE
    bottom = top + -(-len(models) // columns) * tile_height
    sheet = Image.new("RGB", (width, bottom + _LINE * len(notes) + _MARGIN), _PAPER)
    pen = ImageDraw.Draw(sheet)
    title = f"{objects.name}: {len(models)} objects, {len(objects.excluded)} excluded"
    pen.text((_MARGIN, _MARGIN), title, _INK, ImageFont.load_default(15))
    for index, model in enumerate(models):
        row, column = divmod(index, columns)
        corner = (_MARGIN + column * (size + _MARGIN), top + row * tile_height)
        sheet.paste(Image.fromarray(portrait(model, size)), corner)
        _write_caption(pen, model, corner[0], corner[1] + size, size)
    for number, line in enumerate(notes):
        pen.text((_MARGIN, bottom + number * _LINE), line, _INK, _font())
    return sheet


def portrait(model: ObjectModel, size: int) -> NDArray[np.uint8]:
    """Return a picture (size, size, 3) of one object from a three-quarter view."""
    low, high = model.vertices.min(axis=0), model.vertices.max(axis=0)
    target = np.array([0.0, 0.0, 2.0])  # Well above the table, which is cut out anyway.
    pose = np.array([*(target - (low + high) / 2), 1.0, 0.0, 0.0, 0.0])
    eye = target + _DISTANCE * model.radius * _VIEW
    pixels = size * _OVERSAMPLING
    view = Camera(pixels, pixels, 1.0, 1.0, 0.0, 0.0, look_at(eye, target, (0.0, 0.0, 1.0)))
    outline = view.project(model.vertices + pose[:3])[:, :2]
    focal = _FILL * pixels / np.ptp(outline, axis=0).max()
    column, row = (pixels - 1) / 2 - focal * (outline.min(axis=0) + outline.max(axis=0)) / 2
    camera = replace(view, fx=focal, fy=focal, cx=column, cy=row)
    frame = Renderer([model]).frame(camera, pose[None], colour=True)
    if frame.rgb is None:
        raise MechSearchError(f"no colours were rendered for {model.name}")
    colours = np.where((frame.ids == BACKGROUND)[..., None], _TILE, frame.rgb)
    image = Image.fromarray(colours)
    return np.asarray(image.resize((size, size), Image.Resampling.BOX))


def _write_caption(
    pen: ImageDraw.ImageDraw, model: ObjectModel, left: int, top: int, width: int
) -> None:
    sides = " x ".join(f"{1000 * side:.0f}" for side in np.ptp(model.vertices, axis=0))
    count = "1 part" if len(model.parts) == 1 else f"{len(model.parts)} parts"
    lines = [
        (model.name, _INK),
        (f"{1000 * model.mass:.4g} g, {sides} mm", _FAINT),
        (
            f"{count}, hull error {1000 * model.hull_error:.1f} mm",
            _RED if model.hull_error > FLAGGED_ERROR else _FAINT,
        ),
    ]
    for number, (text, colour) in enumerate(lines):
        while len(text) > 1 and pen.textlength(text, _font()) > width:
            text = text[:-1]
        pen.text((left, top + 2 + number * _LINE), text, colour, _font())


def _excluded_lines(objects: ObjectSet, width: int) -> list[str]:
    if not objects.excluded:
        return []
    listed = [f"{name}: {reason}" for name, reason in objects.excluded.items()]
    lines = [part for entry in listed for part in textwrap.wrap(entry, max(24, width // 7))]
    return ["Excluded:", *lines]


def _font() -> ImageFont.ImageFont | ImageFont.FreeTypeFont:
    return ImageFont.load_default(11)
