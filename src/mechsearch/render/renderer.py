"""Ray casting with Embree: one static scene for each object, built once.

The rays that may meet an object are moved into its frame and cast against it alone. The nearest
hit over all objects gives depth and instance ids, and each object's own hits are its amodal mask.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from mechsearch.camera import Camera
from mechsearch.geometry import rotation_from_quaternion
from mechsearch.objects.model import ObjectModel
from mechsearch.types import Array, Floats, MechSearchError

BACKGROUND = -1
PUSHER = -2
_NO_HIT = 1e30
_TABLE_COLOUR = np.array([196, 186, 170], np.float64)
_FLOOR_COLOUR = np.array([90, 92, 96], np.float64)
_LIGHT = np.array([0.35, -0.25, 0.9]) / np.linalg.norm([0.35, -0.25, 0.9])


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
class Hits:
    """First hits of a bundle of rays on one object.

    Attributes:
        index: Which of the flattened rays may meet the object (K,).
        depth: Distance (K,) in units of each ray's direction; above 1e30 where it misses.
        triangle: Face index (K,); -1 where it misses.
        u: Weight of the face's second vertex (K,).
        v: Weight of the face's third vertex (K,).
    """

    index: NDArray[np.intp]
    depth: NDArray[np.float32]
    triangle: NDArray[np.int32]
    u: NDArray[np.float32]
    v: NDArray[np.float32]


class Body:
    """One object's static scene, with what its colours need."""

    def __init__(self, model: ObjectModel) -> None:
        """Build the scene of a model's visual mesh."""
        corners = model.vertices[model.faces]
        self._scene = EmbreeScene()
        self._mesh = TriangleMesh(self._scene, np.ascontiguousarray(corners, np.float32))
        self.radius = model.radius
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        self._normals = normals / np.maximum(lengths, 1e-18)
        self._texels = model.texels
        self._rows = int((np.sqrt(8 * model.texels.shape[1] + 1) - 1) / 2)

    def depths(self, origin: Floats, directions: Array, pose: Floats) -> NDArray[np.float32]:
        """Return the distance (K,) along rays (K, 3) from one origin (3,), in the world frame."""
        origins, local = _moved_into(pose, origin, directions)
        return np.asarray(self._scene.run(origins, local, query="DISTANCE"), np.float32)

    def cast(self, origin: Floats, directions: Array, pose: Floats, index: Array) -> Hits:
        """Return the first hits of rays (K, 3) from one origin (3,), in the world frame."""
        origins, local = _moved_into(pose, origin, directions)
        hit = self._scene.run(origins, local, output=1)
        return Hits(index, hit["tfar"], hit["primID"], hit["u"], hit["v"])

    def colours(self, hits: Hits, pose: Floats) -> NDArray[np.uint8]:
        """Return the shaded colour (K, 3) of hits that all met the object."""
        n = self._rows
        i = np.minimum((hits.u * n).astype(np.intp), n - 1)
        j = np.clip((hits.v * n).astype(np.intp), 0, n - 1 - i)
        base = self._texels[hits.triangle, i * n - i * (i - 1) // 2 + j]
        normals = self._normals[hits.triangle] @ rotation_from_quaternion(pose[3:]).T
        shade = 0.55 + 0.45 * np.abs(normals @ _LIGHT)
        return np.asarray(np.clip(base * shade[:, None], 0, 255), np.uint8)


@cache
def body_of(model: ObjectModel) -> Body:
    """Return a model's scene, built once in each process."""
    return Body(model)


def _moved_into(pose: Floats, origin: Floats, directions: Array) -> tuple[Array, Array]:
    rotation = rotation_from_quaternion(pose[3:])
    local = np.ascontiguousarray(directions @ rotation.astype(np.float32))
    start = ((origin - pose[:3]) @ rotation).astype(np.float32)
    origins = np.empty_like(local)
    origins[:] = start
    return origins, local


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
        self._rays: dict[Camera, tuple[Floats, NDArray[np.float32], Array, Array]] = {}

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
        origin, directions, background, table_colour = self._view(camera)
        depth = background.copy()
        ids = np.full(depth.shape, BACKGROUND, np.int16)
        amodal = np.zeros((len(self.bodies), depth.size), np.bool_)
        rgb = table_colour.copy() if colour else None
        entries = [(i, body, states[i]) for i, body in enumerate(self.bodies)]
        if self._pusher is not None and pusher is not None:
            entries.append((PUSHER, self._pusher, np.asarray(pusher, np.float64)))
        for identity, body, pose in entries:
            index = _pixels_near(camera, pose[:3], body.radius)
            if not index.size:
                continue
            hits = body.cast(origin, directions[index], pose, index)
            met = hits.triangle >= 0
            if identity >= 0:
                amodal[identity, index[met]] = True
            nearer = met & (hits.depth < depth[index])
            chosen = index[nearer]
            depth[chosen] = hits.depth[nearer]
            ids[chosen] = identity
            if rgb is not None and chosen.size:
                part = Hits(
                    chosen,
                    hits.depth[nearer],
                    hits.triangle[nearer],
                    hits.u[nearer],
                    hits.v[nearer],
                )
                rgb[chosen] = body.colours(part, pose)
        depth[depth > _NO_HIT] = 0.0
        shape = (camera.height, camera.width)
        return Frame(
            depth.reshape(shape),
            ids.reshape(shape),
            amodal.reshape(-1, *shape),
            None if rgb is None else rgb.reshape(*shape, 3),
        )

    def _view(self, camera: Camera) -> tuple[Floats, NDArray[np.float32], Array, Array]:
        if camera not in self._rays:
            pose = camera.pose
            directions = (camera.directions() @ pose[:3, :3].T).reshape(-1, 3)
            depth, colour = self._background(pose[:3, 3], directions)
            self._rays[camera] = (pose[:3, 3], directions.astype(np.float32), depth, colour)
        return self._rays[camera]

    def _background(self, origin: Floats, directions: Floats) -> tuple[Array, Array]:
        depth = np.full(len(directions), np.inf)
        colour = np.tile(_FLOOR_COLOUR, (len(directions), 1))
        down = directions[:, 2] < 0
        for height, shade in ((self._floor, _FLOOR_COLOUR), (0.0, _TABLE_COLOUR)):
            distance = np.full(len(directions), np.inf)
            distance[down] = (height - origin[2]) / directions[down, 2]
            with np.errstate(invalid="ignore"):
                points = origin + directions * distance[:, None]
                on_table = np.abs(points[:, :2]).max(axis=1) <= self._table_half
            hit = down & (distance > 0) & (on_table if height == 0.0 else True)
            depth[hit] = distance[hit]
            colour[hit] = shade
        return depth.astype(np.float32), colour.astype(np.uint8)


def _pixels_near(camera: Camera, centre: Floats, radius: float) -> NDArray[np.intp]:
    """Return the flat indices of pixels whose rays may meet a sphere."""
    rows, columns = bounding_box(camera, centre, radius)
    rows = slice(max(rows.start, 0), min(rows.stop, camera.height))
    columns = slice(max(columns.start, 0), min(columns.stop, camera.width))
    if rows.start >= rows.stop or columns.start >= columns.stop:
        return np.empty(0, np.intp)
    grid = np.arange(rows.start, rows.stop)[:, None] * camera.width
    return np.asarray((grid + np.arange(columns.start, columns.stop)).ravel(), np.intp)


def bounding_box(camera: Camera, centre: Floats, radius: float) -> tuple[slice, slice]:
    """Return rows and columns [px] that hold a sphere's projection, beyond the frame too.

    A sphere that reaches the camera plane gets the whole frame.
    """
    pose = camera.pose
    x, y, z = (np.asarray(centre) - pose[:3, 3]) @ pose[:3, :3]
    if z <= radius * 1.05:
        return slice(0, camera.height), slice(0, camera.width)

    def interval(offset: float, focal: float, principal: float) -> slice:
        middle, half = np.arctan2(offset, z), np.arcsin(radius / np.hypot(offset, z))
        low = focal * np.tan(max(middle - half, -1.5)) + principal
        high = focal * np.tan(min(middle + half, 1.5)) + principal
        return slice(int(np.floor(low)), int(np.ceil(high)) + 1)

    return interval(y, camera.fy, camera.cy), interval(x, camera.fx, camera.cx)
