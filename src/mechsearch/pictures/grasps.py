"""Grasps drawn on the depth image they were planned on, and strips of the lifts that follow."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from mechsearch.camera import Camera, look_at
from mechsearch.grippers import AnyGripper, GraspView, ImageGrasp
from mechsearch.objects.model import ObjectModel
from mechsearch.pictures import canvas
from mechsearch.render.renderer import Renderer
from mechsearch.sim import LiftFrame, gripper_models
from mechsearch.types import Floats, MechSearchError

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
        width = 4 if i == 0 else 1
        along, across = half_width * grasp.axis, 0.22 * half_width * grasp.axis[::-1] * [-1, 1]
        ends = middle - along, middle + along
        pen.line([*map(tuple, ends)], colour, max(1, width // 2))
        for end in ends:
            pen.line([tuple(end - across), tuple(end + across)], colour, width)
    return canvas.captioned(picture, caption, text=max(12, size // 28))


def _shaded(view: GraspView, top: int, left: int, side: int) -> NDArray[np.uint8]:
    """Return a square part (side, side, 3) of the view in grey, the target tinted."""
    height, width = view.depth.shape
    rows = np.clip(np.arange(top, top + side), 0, height - 1)
    columns = np.clip(np.arange(left, left + side), 0, width - 1)
    depth = view.depth[np.ix_(rows, columns)].astype(np.float64)
    near = float(np.percentile(depth, 1))
    grey = 235 - 190 * np.clip((depth - near) / max(view.far - near, 1e-3), 0, 1)
    colour = np.repeat(grey[..., None], 3, axis=2)
    return canvas.tinted(colour.astype(np.uint8), view.mask[np.ix_(rows, columns)])


def _colour(quality: float) -> tuple[int, int, int]:
    share = 0.0 if np.isnan(quality) else min(max(quality, 0.0), 1.0)
    red, green, blue = (_LOW + share * (_HIGH - _LOW)).astype(int).tolist()
    return red, green, blue


def lift_strip(
    frames: Sequence[LiftFrame],
    models: Sequence[ObjectModel],
    gripper: AnyGripper,
    target: int,
    caption: str,
    count: int = 8,
    size: int = 200,
) -> Image.Image:
    """Return `count` frames of a filmed lift side by side, from the first to the last.

    Args:
        frames: The film, as `LiftWorld.lift` took it.
        models: Objects of the heap, in the order of its poses.
        gripper: The gripper.
        target: Index of the target.
        caption: Written below.
        count: Frames to show.
        size: Side of a frame [px].

    Raises:
        MechSearchError: If the film is empty.
    """
    if not frames:
        raise MechSearchError("the film of this lift has no frames; pass a list as its `film`")
    middle = frames[-1].gripper[1:, :3].mean(axis=0) * [1, 1, 0] + [0, 0, 0.1]
    eye = middle + 0.55 * _across(frames[0].gripper) + [0.0, 0.0, 0.4]
    pixels, text = size * canvas.SMOOTHING, max(11, size // 13)
    centre = (pixels - 1) / 2
    pose, focal = look_at(eye, middle, (0, 0, 1)), 1.45 * pixels
    camera = Camera(pixels, pixels, focal, focal, centre, centre, pose)
    renderer = Renderer([*models, *gripper_models(gripper)])
    tiles = []
    for frame in (frames[i] for i in _spread(frames, count)):
        poses = np.concatenate([frame.poses, frame.gripper])
        tile = canvas.shrunk(canvas.photographed(renderer, camera, poses, target), size)
        ImageDraw.Draw(tile).text((4, 2), frame.phase, "white", font_size=text)
        tiles.append(tile)
    return canvas.captioned(canvas.tiled(tiles, len(tiles), gap=0), caption, text=text)


def _across(parts: Floats) -> Floats:
    """Return the horizontal direction (3,) across the line between two fingers, towards -y.

    A gripper without two fingers is seen from -y.
    """
    closing = parts[1, :3] - parts[-1, :3]
    across = np.array([closing[1], -closing[0], 0.0])
    length = float(np.linalg.norm(across))
    if length < 1e-6:
        return np.array([0.0, -1.0, 0.0])
    across /= length
    return across if across[1] < 0 else -across


def _spread(frames: Sequence[LiftFrame], count: int) -> list[int]:
    """Return indices of frames, most of them after the descent."""
    last = len(frames) - 1
    down = [i for i, frame in enumerate(frames) if frame.phase == "descend"]
    rest = last - len(down)
    if rest < 2:
        return sorted({round(i * last / max(count - 1, 1)) for i in range(count)})
    later = {len(down) + round(i * rest / max(count - 3, 1)) for i in range(count - 2)}
    return sorted({0, len(down) - 1, *(min(i, last) for i in later)} - {-1})
