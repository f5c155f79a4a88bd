"""A camera's rays, and where objects may appear in its image."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mechsearch.camera import Camera
from mechsearch.render.body import Body
from mechsearch.types import Array, Floats

_NEAREST = 0.01
"""Objects that come nearer to the camera's plane [m] may appear anywhere."""


@dataclass(frozen=True)
class Block:
    """A rectangle of pixels, which may reach beyond the frame; empty where an end is not after."""

    top: int
    bottom: int
    left: int
    right: int

    @property
    def empty(self) -> bool:
        """Whether it holds no pixel."""
        return self.top >= self.bottom or self.left >= self.right

    @property
    def of(self) -> tuple[slice, slice]:
        """Rows and columns, to index an image (H, W) with."""
        return slice(self.top, self.bottom), slice(self.left, self.right)

    def within(self, other: "Block") -> "Block":
        """Return the overlap with another block, counted from that one's corner."""
        return Block(
            max(self.top, other.top) - other.top,
            min(self.bottom, other.bottom) - other.top,
            max(self.left, other.left) - other.left,
            min(self.right, other.right) - other.left,
        )


class View:
    """Rays of a camera through the centres of its pixels."""

    def __init__(self, camera: Camera) -> None:
        """Take a camera's pose and intrinsics."""
        self.camera = camera
        self.frame = Block(0, camera.height, 0, camera.width)
        self.origin: Floats = camera.pose[:3, 3]
        self._axes = camera.pose[:3, :3]

    def rays(self, block: Block) -> NDArray[np.float32]:
        """Return the directions (h, w, 3) of a block's rays, as long as 1 m of depth."""
        camera = self.camera
        u = (np.arange(block.left, block.right) - camera.cx) / camera.fx
        v = (np.arange(block.top, block.bottom) - camera.cy) / camera.fy
        axes = self._axes
        rays = u[None, :, None] * axes[:, 0] + v[:, None, None] * axes[:, 1] + axes[:, 2]
        return rays.astype(np.float32)

    def blocks(self, bodies: Sequence[Body], positions: Array, rotations: Array) -> list[Block]:
        """Return where each body's bounding box appears, beyond the frame too.

        Args:
            bodies: N objects.
            positions: Of theirs (N, 3) [m].
            rotations: Of theirs (N, 3, 3).
        """
        if not bodies:
            return []
        corners = np.stack([body.corners for body in bodies])
        turned = np.matmul(corners, np.transpose(rotations, (0, 2, 1)))
        local = (turned + (positions - self.origin)[:, None]) @ self._axes
        z = local[..., 2]
        behind = z.min(axis=1) < _NEAREST
        z = np.maximum(z, _NEAREST)
        camera = self.camera
        u = camera.fx * local[..., 0] / z + camera.cx
        v = camera.fy * local[..., 1] / z + camera.cy
        low = np.floor(np.stack([v.min(axis=1), u.min(axis=1)], axis=1)).astype(int).tolist()
        high = np.ceil(np.stack([v.max(axis=1), u.max(axis=1)], axis=1)).astype(int).tolist()
        return [
            self.frame if near else Block(top, bottom + 1, left, right + 1)
            for (top, left), (bottom, right), near in zip(low, high, behind.tolist(), strict=True)
        ]
