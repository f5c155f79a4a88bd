"""Renders heaps by casting rays with Embree against one static scene for each object.

The nearest hit over all objects gives depth and instance ids, and each object's own hits are its
amodal mask. What an object shows is kept until it moves.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mechsearch.camera import Camera
from mechsearch.objects.model import ObjectModel
from mechsearch.render.body import NO_HIT, Body, body_of
from mechsearch.render.view import Block, View
from mechsearch.types import Array, Floats, MechSearchError

BACKGROUND = -1
PUSHER = -2
_TABLE_COLOUR = np.array([196, 186, 170], np.float64)
_FLOOR_COLOUR = np.array([90, 92, 96], np.float64)


@dataclass(frozen=True)
class Frame:
    """What one camera sees at one instant.

    Attributes:
        depth: Along the optical axis (H, W) float32 [m]; 0 where nothing is.
        ids: Object index of each pixel (H, W) int16; `BACKGROUND` or `PUSHER` elsewhere.
        amodal: Whole projection of each object (N, H, W) bool, whatever hides it.
        rgb: Colour (H, W, 3) uint8, or None when not asked for.
    """

    depth: NDArray[np.float32]
    ids: NDArray[np.int16]
    amodal: NDArray[np.bool_]
    rgb: NDArray[np.uint8] | None

    def modal(self, index: int) -> NDArray[np.bool_]:
        """Return the visible pixels (H, W) of one object."""
        return np.asarray(self.ids == index, np.bool_)


@dataclass(frozen=True)
class _Patch:
    """What one body shows: distances (h, w) in a block of pixels."""

    block: Block
    depth: NDArray[np.float32]


@dataclass
class _Seen:
    """What one camera saw last, without pusher and colour.

    Attributes:
        view: The camera's rays.
        rays: Of the whole frame (H, W, 3).
        empty: Depth (H, W) of table and floor.
        colour: Likewise (H, W, 3).
        poses: Of the objects (N, 7) in `frame`.
        patches: Of the objects in `frame`.
        frame: Its depth is infinite where nothing is.
    """

    view: View
    rays: NDArray[np.float32]
    empty: NDArray[np.float32]
    colour: NDArray[np.uint8]
    poses: Array = field(default_factory=lambda: np.empty(0))
    patches: list[_Patch] = field(default_factory=list)
    frame: Frame | None = None


class Renderer:
    """Renders heaps of a fixed list of objects over a table at height 0."""

    def __init__(
        self,
        models: Sequence[ObjectModel],
        pusher: ObjectModel | None = None,
        table_half: float = 0.4,
        floor: float = -0.75,
    ) -> None:
        """Build every object's scene.

        Args:
            models: The objects, in the order of the poses given to `frame`.
            pusher: The end effector, or None.
            table_half: Half the side of the square table [m].
            floor: Height of the floor around the table [m].
        """
        self.bodies = [body_of(model) for model in models]
        self._pusher = body_of(pusher) if pusher is not None else None
        self._table_half = table_half
        self._floor = floor
        self._seen: dict[Camera, _Seen] = {}

    def frame(
        self, camera: Camera, poses: Array, pusher: Array | None = None, colour: bool = False
    ) -> Frame:
        """Render one instant.

        Args:
            camera: The view.
            poses: Of every object (N, 7), metres and scalar-first quaternions.
            pusher: Pose (7,) of the end effector; None leaves it out of view.
            colour: Whether to look up colours too.

        Raises:
            MechSearchError: If the poses do not fit the objects.
        """
        states = np.asarray(poses, np.float64)
        if states.shape != (len(self.bodies), 7):
            raise MechSearchError(
                f"poses are {states.shape}; expected ({len(self.bodies)}, 7) for this heap"
            )
        seen = self._looking(camera)
        heap, shown = self._heap(seen, states, pusher)
        depth, ids = heap.depth.copy(), heap.ids.copy()
        if shown is not None:
            _compose(depth, ids, shown, PUSHER)
        rgb = self._colours(seen, states, pusher, ids) if colour else None
        depth[depth > NO_HIT] = 0.0
        return Frame(depth, ids, heap.amodal.copy(), rgb)

    def _looking(self, camera: Camera) -> _Seen:
        if camera not in self._seen:
            view = View(camera)
            rays = view.rays(view.frame)
            depth, colour = self._background(view.origin, rays.astype(np.float64))
            self._seen[camera] = _Seen(view, rays, depth, colour)
        return self._seen[camera]

    def _heap(
        self, seen: _Seen, states: Floats, pusher: Array | None
    ) -> tuple[Frame, _Patch | None]:
        """Return the objects without the pusher, and what the pusher shows.

        Nothing is cast for objects that lie as before.
        """
        moved = np.ones(len(states), np.bool_)
        if seen.frame is not None:
            moved = (states != seen.poses).any(axis=1)
        which = np.flatnonzero(moved).tolist()
        bodies, poses = [self.bodies[i] for i in which], states[moved]
        if self._pusher is not None and pusher is not None:
            bodies.append(self._pusher)
            poses = np.vstack([poses, pusher])
        patches = _cast(seen, bodies, poses)
        shown = patches.pop() if len(bodies) > len(which) else None
        if seen.frame is None or which:
            kept = seen.patches or [_nothing(seen)] * len(states)
            for i, patch in zip(which, patches, strict=True):
                kept[i] = patch
            seen.patches, seen.poses = kept, states.copy()
            seen.frame = self._composed(seen)
        return seen.frame, shown

    def _composed(self, seen: _Seen) -> Frame:
        depth = seen.empty.copy()
        ids = np.full(depth.shape, BACKGROUND, np.int16)
        amodal = np.zeros((len(self.bodies), *depth.shape), np.bool_)
        for i, patch in enumerate(seen.patches):
            amodal[i][patch.block.of] = patch.depth < NO_HIT
            _compose(depth, ids, patch, i)
        return Frame(depth, ids, amodal, None)

    def _colours(
        self, seen: _Seen, states: Floats, pusher: Array | None, ids: NDArray[np.int16]
    ) -> NDArray[np.uint8]:
        rgb = seen.colour.copy()
        for identity in np.unique(ids[ids != BACKGROUND]).tolist():
            body = self._pusher if identity == PUSHER else self.bodies[identity]
            pose = np.asarray(pusher if identity == PUSHER else states[identity], np.float64)
            assert body is not None
            shown, pixels = seen.view.appearances([body], pose[None]), ids == identity
            hits = body.cast(shown.starts[0], seen.rays[pixels], shown.rotations[0])
            rgb[pixels] = body.colours(hits, shown.rotations[0])
        return rgb

    def _background(
        self, origin: Floats, rays: Floats
    ) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        depth = np.full(rays.shape[:2], np.inf)
        colour = np.empty(rays.shape)
        colour[:] = _FLOOR_COLOUR
        down = rays[..., 2] < 0
        for height, shade in ((self._floor, _FLOOR_COLOUR), (0.0, _TABLE_COLOUR)):
            distance = np.full(depth.shape, np.inf)
            distance[down] = (height - origin[2]) / rays[down, 2]
            with np.errstate(invalid="ignore"):
                points = origin + rays * distance[..., None]
                on_table = np.abs(points[..., :2]).max(axis=-1) <= self._table_half
            hit = down & (distance > 0) & (on_table if height == 0.0 else True)
            depth[hit] = distance[hit]
            colour[hit] = shade
        return depth.astype(np.float32), colour.astype(np.uint8)


def _nothing(seen: _Seen) -> _Patch:
    return _Patch(Block(0, 0, 0, 0), seen.empty[:0, :0])


def _cast(seen: _Seen, bodies: Sequence[Body], poses: Floats) -> list[_Patch]:
    """Return what bodies at poses (N, 7) show in the frame."""
    shown = seen.view.appearances(bodies, poses)
    patches = []
    for i, body in enumerate(bodies):
        block = shown.blocks[i].within(seen.view.frame)
        if block.empty:
            patches.append(_nothing(seen))
            continue
        rays = seen.rays[block.of]
        depth = body.depths(shown.starts[i], rays.reshape(-1, 3), shown.rotations[i])
        patches.append(_Patch(block, depth.reshape(rays.shape[:2])))
    return patches


def _compose(
    depth: NDArray[np.float32], ids: NDArray[np.int16], patch: _Patch, identity: int
) -> None:
    """Draw a patch where it is nearer than what is there."""
    part = depth[patch.block.of]
    nearer = patch.depth < part
    np.copyto(part, patch.depth, where=nearer)
    np.copyto(ids[patch.block.of], identity, where=nearer)
