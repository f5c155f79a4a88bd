"""Pictures of lift tests: a strip of frames, the target green."""

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

from mechsearch.camera import Camera, look_at
from mechsearch.objects.model import ObjectModel
from mechsearch.pictures.canvas import SMOOTHING, captioned, shrunk, tiled, tinted
from mechsearch.render.renderer import Renderer
from mechsearch.sim.gripper import Gripper
from mechsearch.sim.lift import LiftFrame
from mechsearch.types import Floats, MechSearchError


def lift_strip(
    frames: Sequence[LiftFrame],
    models: Sequence[ObjectModel],
    gripper: Gripper,
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
    chosen = [frames[i] for i in _spread(frames, count)]
    middle = frames[-1].gripper[1:, :3].mean(axis=0) * [1, 1, 0] + [0, 0, 0.1]
    first = frames[0].gripper[0, :3]
    across = _across(first, frames[0].gripper)
    eye = middle + 0.55 * across + [0.0, 0.0, 0.4]
    pixels, text = size * SMOOTHING, max(11, size // 13)
    centre = (pixels - 1) / 2
    pose, focal = look_at(eye, middle, (0, 0, 1)), 1.45 * pixels
    camera = Camera(pixels, pixels, focal, focal, centre, centre, pose)
    renderer = Renderer([*models, *gripper.models()])
    tiles = []
    for frame in chosen:
        seen = renderer.frame(camera, np.concatenate([frame.poses, frame.gripper]), colour=True)
        assert seen.rgb is not None
        tile = shrunk(Image.fromarray(tinted(seen.rgb, seen.modal(target))), size)
        ImageDraw.Draw(tile).text((4, 2), frame.phase, "white", font_size=text)
        tiles.append(tile)
    return captioned(tiled(tiles, len(tiles), gap=0), caption, text=text)


def _across(centre: Floats, parts: Floats) -> Floats:
    """Return the horizontal direction (3,) across the closing direction, towards -y."""
    closing = parts[1, :3] - parts[2, :3]
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
