"""Grasps drawn on the depth image they were planned on."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from mechsearch.grasp.grasp_view import GraspView, ImageGrasp
from mechsearch.pictures.canvas import captioned, tinted
from mechsearch.types import Floats

_LOW, _HIGH = np.array([214.0, 60.0, 45.0]), np.array([28.0, 98.0, 235.0])


def draw_grasps(
    view: GraspView,
    grasps: Sequence[ImageGrasp],
    caption: str,
    opening: float = 0.056,
    size: int = 420,
    margin: int = 30,
) -> Image.Image:
    """Return the part of the image around the target with the grasps, the best one bold.

    Near is light and far is dark, the target green. Each grasp shows its two open fingers and the
    line along which they close, red for a quality of 0 and blue for 1.

    Args:
        view: What the grasps were planned on.
        grasps: Best first.
        caption: Written below.
        opening: Of the gripper [m].
        size: Side of the picture without the caption [px].
        margin: Least distance between target and border of the part shown [px of the image].
    """
    rows, columns = np.nonzero(view.mask)
    centre = (rows.min() + rows.max()) / 2, (columns.min() + columns.max()) / 2
    half = max(np.ptp(rows), np.ptp(columns)) / 2 + margin
    top, left = round(centre[0] - half), round(centre[1] - half)
    side = 2 * int(half) + 1
    scale = size / side
    picture = Image.fromarray(_shaded(view, top, left, side)).resize((size, size))
    pen = ImageDraw.Draw(picture)
    for i, grasp in reversed(list(enumerate(grasps))):
        colour = _colour(grasp.quality)
        half_width = view.camera.fx * opening / grasp.depth / 2 * scale
        middle = np.array([grasp.column + 0.5 - left, grasp.row + 0.5 - top]) * scale
        _draw_jaws(pen, middle, grasp.axis, half_width, colour, 4 if i == 0 else 1)
    return captioned(picture, caption, text=max(12, size // 28))


def _shaded(view: GraspView, top: int, left: int, side: int) -> NDArray[np.uint8]:
    """Return a square part (side, side, 3) of the view in grey, the target tinted."""
    height, width = view.depth.shape
    rows = np.clip(np.arange(top, top + side), 0, height - 1)
    columns = np.clip(np.arange(left, left + side), 0, width - 1)
    depth = view.depth[np.ix_(rows, columns)].astype(np.float64)
    near = float(np.percentile(depth, 1))
    grey = 235 - 190 * np.clip((depth - near) / max(view.far - near, 1e-3), 0, 1)
    colour = np.repeat(grey[..., None], 3, axis=2)
    return tinted(colour.astype(np.uint8), view.mask[np.ix_(rows, columns)])


def _draw_jaws(
    pen: ImageDraw.ImageDraw,
    middle: Floats,
    axis: Floats,
    half: float,
    colour: tuple[int, int, int],
    width: int,
) -> None:
    across = np.array([-axis[1], axis[0]]) * 0.22 * half
    ends = middle - half * axis, middle + half * axis
    pen.line([*map(tuple, ends)], colour, max(1, width // 2))
    for end in ends:
        pen.line([tuple(end - across), tuple(end + across)], colour, width)


def _colour(quality: float) -> tuple[int, int, int]:
    share = 0.0 if np.isnan(quality) else min(max(quality, 0.0), 1.0)
    red, green, blue = (_LOW + share * (_HIGH - _LOW)).astype(int).tolist()
    return red, green, blue
