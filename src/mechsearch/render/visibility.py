"""Occlusion: the share of an object's whole projection that other objects hide."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mechsearch.camera import Camera
from mechsearch.render.renderer import Body, bounding_box
from mechsearch.types import Array, Floats


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
    states = np.asarray(poses, np.float64)
    dense = camera.resized(camera.height * density)
    origin, directions = _rays_towards(dense, states[target, :3], bodies[target].radius)
    depth = bodies[target].depths(origin, directions, states[target])
    met = depth < 1e30
    if not met.any():
        return 1.0
    directions, depth = directions[met], depth[met]
    hidden = np.zeros(len(depth), np.bool_)
    for i, body in enumerate(bodies):
        if i == target:
            continue
        near = _may_meet(origin, directions, states[i, :3], body.radius) & ~hidden
        if near.any():
            index = np.flatnonzero(near)
            hidden[index] = body.depths(origin, directions[index], states[i]) < depth[index]
    return float(hidden.mean())


def _rays_towards(
    camera: Camera, centre: Floats, radius: float
) -> tuple[Floats, NDArray[np.float32]]:
    rows, columns = bounding_box(camera, centre, radius)
    u, v = np.meshgrid(
        (np.arange(columns.start, columns.stop) - camera.cx) / camera.fx,
        (np.arange(rows.start, rows.stop) - camera.cy) / camera.fy,
    )
    local = np.stack([u.ravel(), v.ravel(), np.ones(u.size)], axis=1)
    pose = camera.pose
    return pose[:3, 3], (local @ pose[:3, :3].T).astype(np.float32)


def _may_meet(
    origin: Floats, directions: NDArray[np.float32], centre: Floats, radius: float
) -> NDArray[np.bool_]:
    """Return which rays (K,) pass a sphere closer than its radius."""
    offset = (centre - origin).astype(np.float32)
    along = directions @ offset
    squared = np.einsum("ij,ij->i", directions, directions)
    result: NDArray[np.bool_] = offset @ offset - along**2 / squared <= np.float32(radius**2)
    return result
