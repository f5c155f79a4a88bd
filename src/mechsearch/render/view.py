"""A camera's rays, and where objects may appear in its image."""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mechsearch.camera import Camera
from mechsearch.geometry import rotation_from_quaternion
from mechsearch.render.body import Body
from mechsearch.types import Floats

_NEAREST = 0.01
"""Objects that come nearer to the camera's plane [m] may appear anywhere."""


class Block(NamedTuple):
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
        top, bottom, left, right = self
        return slice(top, bottom), slice(left, right)

    def within(self, other: "Block") -> "Block":
        """Return the overlap with another block, counted from that one's corner."""
        top, bottom, left, right = self
        first, last, start, end = other
        return Block(
            (top if top > first else first) - first,
            (bottom if bottom < last else last) - first,
            (left if left > start else start) - start,
            (right if right < end else end) - start,
        )


@dataclass(frozen=True)
class Appearances:
    """What casting rays against N bodies needs.

    Attributes:
        blocks: Where each may appear, beyond the frame too.
        starts: The camera in each body's frame (N, 3) [m].
        rotations: Of the bodies (N, 3, 3).
    """

    blocks: list[Block]
    starts: NDArray[np.float32]
    rotations: NDArray[np.float32]


@lru_cache(maxsize=64)
def corners_of(bodies: tuple[Body, ...]) -> Floats:
    """Return the corners (N, 8, 3) of all bodies' boxes, each in its own frame [m]."""
    return np.array([body.corners for body in bodies]).reshape(-1, 8, 3)


class View:
    """Rays of a camera through the centres of its pixels."""

    def __init__(self, camera: Camera) -> None:
        """Take a camera's pose and intrinsics."""
        self.camera = camera
        self.frame = Block(0, camera.height, 0, camera.width)
        self.origin: Floats = camera.pose[:3, 3]
        self._axes = camera.pose[:3, :3]
        self._last: tuple[Block, NDArray[np.float32]] | None = None
        self._focal = np.array([camera.fy, camera.fx])
        self._principal = np.array([camera.cy, camera.cx])

    def rays(self, block: Block) -> NDArray[np.float32]:
        """Return the directions (h, w, 3) of a block's rays, as long as 1 m of depth.

        Those of the last block are kept: not to be written into.
        """
        # Read once: views are shared, and another thread may look elsewhere meanwhile.
        last = self._last
        if last is not None and last[0] == block:
            return last[1]
        camera = self.camera
        u = (np.arange(block.left, block.right) - camera.cx) / camera.fx
        v = (np.arange(block.top, block.bottom) - camera.cy) / camera.fy
        across, down, forward = self._axes.T
        rays = v[:, None, None] * down + (u[:, None] * across + forward)
        single: NDArray[np.float32] = rays.astype(np.float32)
        self._last = block, single
        return single

    def appearances(self, corners: Floats, poses: Floats) -> Appearances:
        """Return where bodies at poses (N, 7) appear, by the corners (N, 8, 3) of their boxes."""
        rotations = rotation_from_quaternion(poses[:, 3:])
        offsets = self.origin - poses[:, :3]
        starts = (offsets[:, None] @ rotations)[:, 0]
        # (R c + p - o) A = (c - s) R' A, as the start s is R' (o - p).
        local = (corners - starts[:, None]) @ (rotations.transpose(0, 2, 1) @ self._axes)
        z = local[..., 2:]
        near = z.min(initial=np.inf) < _NEAREST
        depth = np.maximum(z, _NEAREST) if near else z
        pixels = local[..., 1::-1] / depth * self._focal + self._principal
        ends = np.concatenate([pixels.min(axis=1), -pixels.max(axis=1)], axis=1)
        blocks = [
            Block(top, 1 - bottom, left, 1 - right)
            for top, left, bottom, right in np.floor(ends).astype(np.intp).tolist()
        ]
        for i in np.flatnonzero(z.min(axis=(1, 2)) < _NEAREST).tolist() if near else ():
            blocks[i] = self.frame
        return Appearances(blocks, starts.astype(np.float32), rotations.astype(np.float32))
