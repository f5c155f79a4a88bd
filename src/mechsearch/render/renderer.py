"""Renders heaps by casting rays with Embree against one static scene for each object.

The nearest hit over all objects gives depth and instance ids, and each object's own hits are its
amodal mask. What an object shows is kept until it moves.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mechsearch.camera import Camera
from mechsearch.objects.model import ObjectModel
from mechsearch.render.visibility import (
    LIGHT,
    NO_HIT,
    PixelBlock,
    Projection,
    View,
    body_of,
    occlusion,
)
from mechsearch.types import Array, Floats, MechSearchError

BACKGROUND = -1
PUSHER = -2
_TABLE_COLOUR = np.array([196, 186, 170], np.float64)
_VIEWS_KEPT = 8
_FLOOR_COLOUR = np.array([90, 92, 96], np.float64)


class Patch(NamedTuple):
    """What one body shows: distances (h, w) in some rows and columns of the frame."""

    where: tuple[slice, slice]
    depth: NDArray[np.float32]


@dataclass(frozen=True)
class Frame:
    """What one camera sees at one instant.

    What two bodies show at the very same distance is visible of both.

    Attributes:
        depth: Along the optical axis (H, W) float32 [m]; 0 where nothing is.
        rgb: Colour (H, W, 3) uint8, or None when not asked for.
        patches: What each object alone would show.
        pusher: What the end effector alone would show, or None without one.
    """

    depth: NDArray[np.float32]
    rgb: NDArray[np.uint8] | None
    patches: tuple[Patch, ...]
    pusher: Patch | None = None

    def modal(self, index: int) -> NDArray[np.bool_]:
        """Return the visible pixels (H, W) of one object: where nothing is nearer."""
        mask = np.zeros(self.depth.shape, np.bool_)
        patch = self.patches[index]
        np.less_equal(patch.depth, self.depth[patch.where], out=mask[patch.where])
        return mask

    @cached_property
    def ids(self) -> NDArray[np.int16]:
        """Object index of each pixel (H, W), the lowest visible; `BACKGROUND` or `PUSHER` else."""
        ids = np.full(self.depth.shape, BACKGROUND, np.int16)
        bodies = [(PUSHER, self.pusher)] if self.pusher else []
        for identity, patch in (*bodies, *reversed(list(enumerate(self.patches)))):
            ids[patch.where][patch.depth <= self.depth[patch.where]] = identity
        return ids

    @cached_property
    def amodal(self) -> NDArray[np.bool_]:
        """Whole projection of each object (N, H, W), whatever hides it."""
        masks = np.zeros((len(self.patches), *self.depth.shape), np.bool_)
        for mask, patch in zip(masks, self.patches, strict=True):
            mask[patch.where] = patch.depth < NO_HIT
        return masks


@dataclass
class _Seen:
    """What one camera saw last, without pusher and colour.

    Depth is along the optical axis: of table and floor alone in `empty`, of the objects too in
    `depth`; both are infinite where nothing is, which `endless` says can be. `projection` is shared
    with other resolutions of the camera; `poses` (N, 7) are no numbers before the first frame.
    """

    view: View
    projection: Projection
    rays: NDArray[np.float32]
    empty: NDArray[np.float32]
    colour: NDArray[np.uint8]
    endless: bool
    poses: Floats
    patches: tuple[Patch, ...]
    depth: NDArray[np.float32]


class Renderer:
    """Renders heaps of a fixed list of objects over a table at height 0.

    Attributes:
        light: Direction (3,) towards the light, of length 1, in which colours are shaded.
    """

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
        self._all = (*self.bodies, self._pusher) if self._pusher else (*self.bodies,)
        self._table_half = table_half
        self._floor = floor
        self.light: Floats = LIGHT
        self._seen: dict[Camera, _Seen] = {}
        self._projections: dict[tuple[float, ...], Projection] = {}

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
        depth = heap.copy()
        if shown is not None:
            _compose(depth, shown)
        if seen.endless:
            depth[depth > NO_HIT] = 0.0
        frame = Frame(depth, None, seen.patches, shown)
        return replace(frame, rgb=self._colours(seen, frame.ids)) if colour else frame

    def occlusion(
        self, camera: Camera, poses: Array, target: int, present: Array, pusher: Array
    ) -> float:
        """Return how much of one object others hide, in [0, 1]; see `visibility.occlusion`.

        Args:
            camera: The view.
            poses: Of every object (N, 7).
            target: Index of the object in question.
            present: Which objects are there to hide it (N,).
            pusher: Pose (7,) of the end effector, which hides nothing, but is part of the frame
                that follows: placing both at once is cheaper.
        """
        projection = self._projection(camera)
        projection.place(np.concatenate([poses, pusher[None]]))
        return occlusion(self.bodies, camera, poses, target, present=present, projection=projection)

    def _projection(self, camera: Camera) -> Projection:
        """Return how all lay last to a camera; its views at other resolutions share it."""
        key = camera.world_from_camera
        if key not in self._projections:
            self._projections[key] = Projection(camera, self._all)
        return self._projections[key]

    def _looking(self, camera: Camera) -> _Seen:
        seen = self._seen.get(camera)
        if seen is None:
            if len(self._seen) == _VIEWS_KEPT:
                self._seen.clear()
                self._projections.clear()
            view, count = View(camera), len(self.bodies)
            rays = view.all_rays
            empty, colour = self._background(camera.pose[:3, 3], rays.astype(np.float64))
            nothing = Patch((slice(0), slice(0)), empty[:0, :0])
            seen = self._seen[camera] = _Seen(
                view, self._projection(camera), rays, empty, colour,
                endless=bool((empty > NO_HIT).any()),
                poses=np.full((count, 7), np.nan), patches=(nothing,) * count, depth=empty,
            )  # fmt: skip
        return seen

    def _heap(
        self, seen: _Seen, states: Floats, pusher: Array | None
    ) -> tuple[NDArray[np.float32], Patch | None]:
        """Return depth without the pusher (H, W), only to be read, and what the pusher shows.

        Nothing is cast for objects that lie as before.
        """
        count = len(states)
        if self._pusher is not None and pusher is not None:
            seen.projection.place(np.concatenate([states, np.asarray(pusher, np.float64)[None]]))
        else:
            seen.projection.place(states)
        moved = (states != seen.poses).any(axis=1).nonzero()[0].tolist()
        blocks = seen.view.visible_blocks(seen.projection, slice(0 if moved else count, None))
        if moved:
            patches = list(seen.patches)
            for i in moved:
                patches[i] = self._cast(seen, i, blocks[i])
            depth = seen.empty.copy()
            for patch in patches:
                _compose(depth, patch)
            seen.patches, seen.poses, seen.depth = tuple(patches), states.copy(), depth
        if self._pusher is None or pusher is None:
            return seen.depth, None
        return seen.depth, self._cast(seen, count, blocks[-1])

    def _cast(self, seen: _Seen, index: int, block: PixelBlock) -> Patch:
        """Return what a body, the pusher being the last, shows in a block of the frame."""
        top, bottom, left, right = block
        where = slice(top, bottom), slice(left, right)
        if top >= bottom or left >= right:
            return Patch(where, seen.empty[where])
        start, rotation = seen.projection.starts[index], seen.projection.rotations[index]
        depth = self._all[index].depths(start, seen.rays[where].reshape(-1, 3), rotation)
        return Patch(where, depth.reshape(bottom - top, right - left))

    def _colours(self, seen: _Seen, ids: NDArray[np.int16]) -> NDArray[np.uint8]:
        rgb = seen.colour.copy()
        for identity in np.unique(ids[ids != BACKGROUND]).tolist():
            index = len(self.bodies) if identity == PUSHER else identity
            start, rotation = seen.projection.starts[index], seen.projection.rotations[index]
            pixels = ids == identity
            rgb[pixels] = self._all[index].colours(start, seen.rays[pixels], rotation, self.light)
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


def _compose(depth: NDArray[np.float32], patch: Patch) -> None:
    """Draw a patch where it is nearer than what is there."""
    part = depth[patch.where]
    np.minimum(part, patch.depth, out=part)
