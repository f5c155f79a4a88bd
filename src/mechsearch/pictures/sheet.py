"""Contact sheets: every object of a set, or a choice of heaps, on one picture."""

from collections.abc import Mapping, Sequence

import numpy as np
from PIL import Image

from mechsearch.camera import Camera, look_at, preset
from mechsearch.heaps.dataset import Heap
from mechsearch.objects.model import ObjectModel
from mechsearch.pictures.canvas import (
    SMOOTHING,
    WHITE,
    captioned,
    check_side,
    photographed,
    shrunk,
    tiled,
)
from mechsearch.render.renderer import Renderer
from mechsearch.types import MechSearchError


def object_sheet(
    models: Mapping[str, ObjectModel], columns: int = 8, size: int = 144
) -> Image.Image:
    """Return a picture of all objects, each filling its tile, with name, longest side and mass.

    Args:
        models: Objects by name.
        columns: Tiles in a row.
        size: Side of a tile [px].

    Raises:
        MechSearchError: If there is no object or column, or the size is out of range.
    """
    check_side(size)
    if columns < 1:
        raise MechSearchError(f"{columns} columns; expected at least 1")
    if not models:
        raise MechSearchError("there is no object to draw; expected at least one")
    tiles = []
    for name, model in models.items():
        longest = np.ptp(model.vertices, axis=0).max()
        facts = f"{longest * 100:.0f} cm, {model.mass * 1000:.0f} g"
        tiles.append(_tile(_portrait(model, size), name.replace("_", " "), facts))
    return tiled(tiles, columns, gap=10, margin=10)


def heap_sheet(
    heaps: Sequence[Heap],
    models: Mapping[str, ObjectModel],
    camera: str = "overhead",
    columns: int = 4,
    size: int = 240,
) -> Image.Image:
    """Return a picture of heaps, the visible part of each target in green.

    Args:
        heaps: What to draw.
        models: Objects by name.
        camera: Name of the view.
        columns: Tiles in a row.
        size: Side of a tile [px].

    Raises:
        MechSearchError: If there is no heap, an object is unknown, or the size is out of range.
    """
    check_side(size)
    if not heaps:
        raise MechSearchError("there is no heap to draw; expected at least one")
    view = preset(camera, size * SMOOTHING)
    tiles = []
    for heap in heaps:
        missing = [name for name in heap.objects if name not in models]
        if missing:
            raise MechSearchError(f"heap {heap.seed} has an object {missing[0]!r} of another set")
        renderer = Renderer([models[name] for name in heap.objects])
        image = photographed(renderer, view, heap.poses, heap.target)
        title = f"{heap.objects[heap.target].replace('_', ' ')}, {heap.occlusion:.0%} hidden"
        facts = f"{heap.condition}, {heap.count} objects" + (", held out" if heap.held_out else "")
        tiles.append(_tile(shrunk(image, size), title, facts))
    return tiled(tiles, columns, gap=10, margin=10)


def _portrait(model: ObjectModel, size: int) -> Image.Image:
    """Return an object seen from above at an angle, filling the frame."""
    middle = (model.vertices.min(axis=0) + model.vertices.max(axis=0)) / 2
    eye = middle + np.array([0.5, -0.9, 0.75]) * model.radius * 5
    pose, pixels = look_at(eye, middle, (0, 0, 1)), size * SMOOTHING
    unit = Camera(pixels, pixels, 1.0, 1.0, 0.0, 0.0, pose)
    focal = 0.47 * pixels / float(np.abs(unit.project(model.vertices)[:, :2]).max())
    centre = (pixels - 1) / 2
    camera = Camera(pixels, pixels, focal, focal, centre, centre, pose)
    lying = np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
    frame = Renderer([model], table_half=0.0, floor=-100.0).frame(camera, lying, colour=True)
    assert frame.rgb is not None
    rgb = np.where((frame.ids == 0)[..., None], frame.rgb, np.array(WHITE)).astype(np.uint8)
    return shrunk(Image.fromarray(rgb), size)


def _tile(image: Image.Image, title: str, facts: str) -> Image.Image:
    return captioned(image, title, facts, text=max(10, image.width // 14))
