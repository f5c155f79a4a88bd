"""One object's static scene of rays, built once, with what its colours need."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from mechsearch.objects.model import ObjectModel
from mechsearch.types import Array, Floats

NO_HIT = 1e30
"""Distances above this met nothing."""

_LIGHT = np.array([0.35, -0.25, 0.9]) / np.linalg.norm([0.35, -0.25, 0.9])


@dataclass(frozen=True)
class Hits:
    """First hits of a bundle of rays on one object.

    Attributes:
        depth: Distance (K,) in units of each ray's direction; above `NO_HIT` where it misses.
        triangle: Face index (K,); -1 where it misses.
        u: Weight of the face's second vertex (K,).
        v: Weight of the face's third vertex (K,).
    """

    depth: NDArray[np.float32]
    triangle: NDArray[np.int32]
    u: NDArray[np.float32]
    v: NDArray[np.float32]


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

    def cast(self, start: Array, directions: Array, rotation: NDArray[np.float32]) -> Hits:
        """Return the first hits of rays; arguments as for `depths`."""
        starts, local = _moved_into(start, directions, rotation)
        hit = self._scene.run(starts, local, output=1)
        return Hits(hit["tfar"], hit["primID"], hit["u"], hit["v"])

    def colours(self, hits: Hits, rotation: Array) -> NDArray[np.uint8]:
        """Return the shaded colour (K, 3) of hits that all met the object."""
        n = self._rows
        i = np.minimum((hits.u * n).astype(np.intp), n - 1)
        j = np.clip((hits.v * n).astype(np.intp), 0, n - 1 - i)
        base = self._texels[hits.triangle, i * n - i * (i - 1) // 2 + j]
        normals = self._normals[hits.triangle] @ rotation.T
        shade = 0.55 + 0.45 * np.abs(normals @ _LIGHT)
        return np.asarray(np.clip(base * shade[:, None], 0, 255), np.uint8)


@cache
def body_of(model: ObjectModel) -> Body:
    """Return a model's scene, built once in each process."""
    return Body(model)


def _moved_into(
    start: Array, directions: Array, rotation: NDArray[np.float32]
) -> tuple[Array, Array]:
    local = directions @ rotation
    # All rays share the memory of one start.
    return np.ndarray(
        local.shape, np.float32, np.ascontiguousarray(start, np.float32), 0, (0, 4)
    ), local
