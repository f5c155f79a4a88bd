"""Occlusion: the share of an object's whole projection that other objects hide."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from mechsearch.camera import Camera
from mechsearch.render.body import NO_HIT, Body
from mechsearch.render.view import Projection, View, overlaps
from mechsearch.types import Array


def occlusion(
    bodies: Sequence[Body],
    camera: Camera,
    poses: Array,
    target: int,
    density: int = 4,
    present: Array | None = None,
    projection: Projection | None = None,
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
        present: Which objects are there to hide it (N,); all by default.
        projection: Of these bodies, or more after them, to a camera there, where they are placed
            already; made anew by default.
    """
    view = _dense(camera, density)
    if projection is None:
        projection = Projection(camera, bodies)
        projection.place(np.asarray(poses, np.float64))
    blocks = view.blocks(projection, slice(len(bodies)))
    starts, rotations = projection.starts, projection.rotations
    block = blocks[target].tolist()
    rays = view.rays(block)
    directions = rays.reshape(-1, 3)
    depth = bodies[target].depths(starts[target], directions, rotations[target])
    # Pixels are counted through: lists of their numbers are quicker than masks.
    pixels = np.arange(len(directions)).reshape(rays.shape[:2])
    seen = depth < NO_HIT
    mask = seen.reshape(pixels.shape)
    whole = int(np.count_nonzero(seen))
    if not whole:
        return 1.0
    for i, (top, bottom, left, right) in enumerate(overlaps(blocks, block)):
        if i == target or top >= bottom or left >= right or not (present is None or present[i]):
            continue
        here = slice(top, bottom), slice(left, right)
        open_ = pixels[here][mask[here]]
        if len(open_):
            nearest = bodies[i].depths(starts[i], directions.take(open_, axis=0), rotations[i])
            seen[open_] = nearest >= depth.take(open_)
    return 1.0 - int(np.count_nonzero(seen)) / whole


@lru_cache(maxsize=8)
def _dense(camera: Camera, density: int) -> View:
    return View(camera.resized(camera.height * density))
