"""Occlusion: the share of an object's whole projection that other objects hide."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from mechsearch.camera import Camera
from mechsearch.render.body import NO_HIT, Body
from mechsearch.render.view import View, corners_of
from mechsearch.types import Array


def occlusion(
    bodies: Sequence[Body], camera: Camera, poses: Array, target: int, density: int = 4
) -> float:
    """Return the occlusion of one object in [0, 1], seen by `camera` (paper, section IV-A).

    Rays are cast `density` times as densely as the camera's pixels over the target's whole
    projection, beyond the frame too; the end effector never counts. A projection too thin for any
    ray counts as wholly hidden.

    Args:
        bodies: Every object's scene.
        camera: The view.
        poses: Of every object (N, 7).
        target: Index of the object in question.
        density: Rays for each pixel, along each axis.
    """
    view = _dense(camera, density)
    shown = view.appearances(corners_of(tuple(bodies)), np.asarray(poses, np.float64))
    blocks = shown.blocks
    rays = view.rays(blocks[target])

    def cast(index: int, directions: Array) -> Array:
        return bodies[index].depths(shown.starts[index], directions, shown.rotations[index])

    depth = cast(target, rays.reshape(-1, 3)).reshape(rays.shape[:2])
    seen = depth < NO_HIT
    whole = int(seen.sum())
    if not whole:
        return 1.0
    for i, block in enumerate(blocks):
        common = block.within(blocks[target])
        if i == target or common.empty:
            continue
        where = common.of
        open_ = seen[where]
        if open_.any():
            open_[open_] = cast(i, rays[where][open_]) >= depth[where][open_]
    return 1.0 - int(seen.sum()) / whole


@lru_cache(maxsize=8)
def _dense(camera: Camera, density: int) -> View:
    return View(camera.resized(camera.height * density))
