"""Rays that meet objects: each object's own scene, where it may appear in an image, and occlusion.

Occlusion is the share of an object's whole projection that other objects hide.
"""

from collections.abc import Sequence
from functools import cached_property, lru_cache

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from mechsearch.camera import Camera
from mechsearch.geometry import rotation_from_quaternion
from mechsearch.objects.model import ObjectModel
from mechsearch.types import Array, Floats

NO_HIT = 1e30
"""Distances above this met nothing."""

LIGHT = np.array([0.35, -0.25, 0.9]) / np.linalg.norm([0.35, -0.25, 0.9])
"""Direction (3,) towards the light."""

_ENDS, _BEYOND = np.array([1.0, -1.0, 1.0, -1.0]), np.array([0.0, 1.0, 0.0, 1.0])

_NEAREST = 0.01
"""Objects that come nearer to the camera's plane [m] may appear anywhere."""


_SCENES = 512
"""Scenes kept in a process; with some thousand of them Embree ends it."""


PixelBlock = list[int]
"""A rectangle of pixels: top, bottom, left and right, the second and last beyond it. It may reach
beyond the frame, and is empty where an end is not after its beginning."""


class Body:
    """One object's static scene; rays are moved into its frame and cast against it alone."""

    def __init__(self, model: ObjectModel) -> None:
        """Build the scene of a model's visual mesh."""
        corners = model.vertices[model.faces]
        self._scene = EmbreeScene()
        self._mesh = TriangleMesh(self._scene, np.ascontiguousarray(corners, np.float32))
        low, high = model.vertices.min(axis=0), model.vertices.max(axis=0)
        grid = np.stack(np.meshgrid(*np.stack([low, high], axis=1), indexing="ij"), axis=-1)
        self.corners: Floats = grid.reshape(8, 3)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        self._normals = normals / np.maximum(lengths, 1e-18)
        self._texels = model.texels
        self._rows = int((np.sqrt(8 * model.texels.shape[1] + 1) - 1) / 2)

    def depths(
        self, start: Array, directions: Array, rotation: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Return how far rays from one point go before they meet the object.

        Args:
            start: Where all rays start, in the object's frame (3,) [m].
            directions: Of the rays, in the world's frame (K, 3) float32.
            rotation: Of the object (3, 3) float32.

        Returns:
            Distances (K,) in units of each ray's direction; above `NO_HIT` where it misses.
        """
        starts, local = _moved_into(start, directions, rotation)
        found: NDArray[np.float32] = self._scene.run(starts, local, query="DISTANCE")
        return found

    def colours(
        self,
        start: Array,
        directions: Array,
        rotation: NDArray[np.float32],
        light: Floats = LIGHT,
    ) -> NDArray[np.uint8]:
        """Return the shaded colour (K, 3) where rays, all of which meet the object, do so first.

        Arguments are those of `depths`, and the direction (3,) towards the light.
        """
        hit = self._scene.run(*_moved_into(start, directions, rotation), output=1)
        triangle = hit["primID"]
        n = self._rows
        i = np.minimum((hit["u"] * n).astype(np.intp), n - 1)
        j = np.clip((hit["v"] * n).astype(np.intp), 0, n - 1 - i)
        base = self._texels[triangle, i * n - i * (i - 1) // 2 + j]
        normals = self._normals[triangle] @ rotation.T
        shade = 0.55 + 0.45 * np.abs(normals @ light)
        return np.asarray(np.clip(base * shade[:, None], 0, 255), np.uint8)


@lru_cache(maxsize=_SCENES)
def body_of(model: ObjectModel) -> Body:
    """Return a model's scene, kept for the next time."""
    return Body(model)


def _moved_into(
    start: Array, directions: Array, rotation: NDArray[np.float32]
) -> tuple[Array, Array]:
    local = directions @ rotation
    # All rays share the memory of one start.
    return np.ndarray(
        local.shape, np.float32, np.ascontiguousarray(start, np.float32), 0, (0, 4)
    ), local


class Projection:
    """How bodies lie to a camera, whatever its resolution; nothing is computed where none moved.

    Attributes:
        starts: The camera in each body's frame (N, 3) [m].
        rotations: Of the bodies (N, 3, 3).
        bounds: Where each appears (N, 4): the least and the greatest y / z in the camera's frame,
            then the same of x / z.
        near: Which come too near to the camera's plane to tell (N,).
    """

    def __init__(self, camera: Camera, bodies: Sequence[Body]) -> None:
        """Take a camera's pose; no body has been placed yet."""
        self._origin: Floats = camera.pose[:3, 3]
        self._axes = camera.pose[:3, :3]
        self._corners = corners_of(tuple(bodies))
        count = len(self._corners)
        self._poses = np.full((count, 7), np.nan)
        self._turned = np.zeros((count, 3, 3))
        # Corner by corner: of so few numbers, the least along the first axis is found soonest.
        self._arms = np.zeros((8, count, 3))
        self.starts: NDArray[np.float32] = np.zeros((count, 3), np.float32)
        self.rotations: NDArray[np.float32] = np.zeros((count, 3, 3), np.float32)
        self.bounds = np.zeros((count, 4))
        self.near = np.zeros(count, np.bool_)

    def place(self, poses: Floats) -> None:
        """Place the first bodies at poses (n, 7)."""
        changed = poses != self._poses[: len(poses)]
        if not changed.any():
            return
        # All from the first that moved: rows that lie together are quicker than some of them.
        rows = slice(int(changed.any(axis=1).argmax()), len(poses))
        self._poses[rows] = poses = poses[rows]
        if changed[:, 3:].any():
            self._turn(rows, poses[:, 3:])
        offsets = self._origin - poses[:, :3]
        self.starts[rows] = (offsets[:, None] @ self._turned[rows])[:, 0]
        local = self._arms[:, rows] - offsets @ self._axes
        z = local[..., 2:]
        slopes = local[..., 1::-1] / np.maximum(z, _NEAREST)
        self.bounds[rows, ::2] = slopes.min(axis=0)
        self.bounds[rows, 1::2] = slopes.max(axis=0)
        self.near[rows] = z.min(axis=0)[:, 0] < _NEAREST

    def _turn(self, rows: slice, quaternions: Floats) -> None:
        """Turn bodies: their corners then point elsewhere along the camera's axes."""
        rotations = rotation_from_quaternion(quaternions)
        self._turned[rows] = self.rotations[rows] = rotations
        arms = self._corners[rows] @ (rotations.transpose(0, 2, 1) @ self._axes)
        self._arms[:, rows] = arms.swapaxes(0, 1)


@lru_cache(maxsize=64)
def corners_of(bodies: tuple[Body, ...]) -> Floats:
    """Return the corners (N, 8, 3) of all bodies' boxes, each in its own frame [m]."""
    return np.array([body.corners for body in bodies]).reshape(-1, 8, 3)


def overlaps(blocks: NDArray[np.intp], block: PixelBlock) -> list[PixelBlock]:
    """Return the parts of some blocks (n, 4) that lie in another, counted from its corner."""
    top, bottom, left, right = block
    corner, size = [top, top, left, left], [bottom - top, bottom - top, right - left, right - left]
    return _clipped(blocks - corner, np.array(size))


def _clipped(blocks: NDArray[np.intp], size: NDArray[np.intp]) -> list[PixelBlock]:
    # `np.clip` takes four times as long for so few numbers.
    clipped: list[PixelBlock] = np.minimum(np.maximum(blocks, 0), size).tolist()
    return clipped


class View:
    """Rays of a camera through the centres of its pixels."""

    def __init__(self, camera: Camera) -> None:
        """Take a camera's pose and intrinsics."""
        self.camera = camera
        self.height, self.width = camera.height, camera.width
        self._size = np.array([camera.height, camera.height, camera.width, camera.width])
        self._focal = np.array([camera.fy, -camera.fy, camera.fx, -camera.fx])
        self._principal = np.array([camera.cy, -camera.cy, camera.cx, -camera.cx])

    @cached_property
    def all_rays(self) -> NDArray[np.float32]:
        """Directions (H, W, 3) of the frame's rays, as long as 1 m of depth; only to be read."""
        return self._directions([0, self.height, 0, self.width])

    def rays(self, block: PixelBlock) -> NDArray[np.float32]:
        """Return the directions (h, w, 3) of a block's rays; only to be read."""
        top, bottom, left, right = block
        if top >= 0 and bottom <= self.height and left >= 0 and right <= self.width:
            return self.all_rays[top:bottom, left:right]
        return self._directions(block)

    def blocks(self, projection: Projection, bodies: slice) -> NDArray[np.intp]:
        """Return where some bodies may appear (n, 4), beyond the frame too."""
        ends = np.floor(projection.bounds[bodies] * self._focal + self._principal)
        blocks: NDArray[np.intp] = (ends * _ENDS + _BEYOND).astype(np.intp)
        near = projection.near[bodies]
        if near.any():
            blocks[near] = [0, self.height, 0, self.width]
        return blocks

    def visible_blocks(self, projection: Projection, bodies: slice) -> list[PixelBlock]:
        """Return where in the frame some bodies may appear."""
        return _clipped(self.blocks(projection, bodies), self._size)

    def _directions(self, block: PixelBlock) -> NDArray[np.float32]:
        camera = self.camera
        top, bottom, left, right = block
        u = (np.arange(left, right) - camera.cx) / camera.fx
        v = (np.arange(top, bottom) - camera.cy) / camera.fy
        across, down, forward = camera.pose[:3, :3].T
        rays = v[:, None, None] * down + (u[:, None] * across + forward)
        single: NDArray[np.float32] = rays.astype(np.float32)
        return single


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
