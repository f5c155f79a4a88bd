"""Assembles one observation, with just the keys that were asked for, and reads a robot's own."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from mechsearch.camera import Camera
from mechsearch.types import (
    IMAGE_KEYS,
    Array,
    Floats,
    MechSearchError,
    real_array,
    select,
)

REACH = 2.0
"""Bound on every coordinate and offset [m]."""

FARTHEST = 10.0
"""Bound on every depth [m]."""

MOST_HOLES = 0.5
"""Share of a depth image from which on it is refused for its holes."""

_MOST_SAMPLES = 8
"""Along a pixel's side, in a view that is denser than the image."""

_TABLE_HALF, _TABLE_ERROR = 0.4, 0.03
"""Half the side of the table, and how far below it a point of it may be measured [m]."""

_BESIDE = 0.02
"""How far outside the workspace an end effector may be measured [m]."""


@dataclass(frozen=True)
class Kind:
    """What an observation key holds.

    Attributes:
        shape: Its sides; a letter stands for one that tasks and objects differ in.
        dtype: Of its numbers.
        low: Least of them.
        high: Greatest of them.
        meaning: What they are.
    """

    shape: tuple[int | str, ...]
    dtype: Any
    low: float
    high: float
    meaning: str

    def __str__(self) -> str:
        sides = str(self.shape).replace("'", "")
        return f"{sides} {self.dtype.__name__} from {self.low:g} to {self.high:g}: {self.meaning}"

    def space(self, **sides: int) -> gymnasium.spaces.Box:
        """Return its space, given how long each letter is."""
        shape = tuple(sides[side] if isinstance(side, str) else side for side in self.shape)
        return gymnasium.spaces.Box(self.low, self.high, shape, self.dtype)


_LEFT = Kind((1,), np.int64, 0, np.iinfo(np.int64).max, "decisions left")
_OFFSET = "m from the end effector"

KINDS = {
    "depth": Kind((1, "H", "W"), np.float16, 0.0, FARTHEST, "m along the optical axis"),
    "position_image": Kind(
        (3, "H", "W"), np.float16, -REACH, REACH,
        f"{_OFFSET} to each visible target pixel, 0 elsewhere",
    ),
    "rgb": Kind((3, "H", "W"), np.uint8, 0, 255, "colours"),
    "target_label": Kind(("L",), np.float32, 0.0, 1.0, "1 for the target's name, 0 for others"),
    "ee_position": Kind((3,), np.float32, -REACH, REACH, "m in the workspace"),
    "target_offset": Kind((3,), np.float32, -REACH, REACH, _OFFSET),
    "clutter_offsets": Kind(("N", 3), np.float32, -REACH, REACH, _OFFSET),
    "clutter_mask": Kind(("N",), np.int8, 0, 1, "1 where there is an object"),
    "grasp_depth": Kind(("G", "G"), np.float32, 0.0, FARTHEST, "m along the optical axis"),
    "segments": Kind(("G", "G"), np.uint8, 0, 255, "0 the table, 1 the target, then the others"),
    "pushes_left": _LEFT, "grasps_left": _LEFT, "removals_left": _LEFT,
    "occlusion": Kind((1,), np.float64, 0.0, 1.0, "hidden share of the target"),
}  # fmt: skip
"""What each key holds, in every environment."""

KEYS = (
    *("depth", "position_image", "rgb", "target_label"),
    *("ee_position", "target_offset", "clutter_offsets", "clutter_mask"),
)


@dataclass(frozen=True)
class Scene:
    """What an observation is made of.

    Attributes:
        depth: Depth image (H, W) [m], 0 in holes, or None when no image is asked for.
        target_mask: Visible target pixels (H, W), or None likewise.
        rgb: Colour image (H, W, 3), or None when not asked for.
        effector: Where the end effector is (3,) [m].
        ee_position: Where it is reported to be (3,) [m].
        positions: Centres of mass of all objects (N, 3) [m].
        present: Which objects are still on the table (N,).
        target: Index of the target.
        label: Index of the target among the object set's names.
    """

    depth: Array | None
    target_mask: Array | None
    rgb: Array | None
    effector: Floats
    ee_position: Floats
    positions: Floats
    present: Array
    target: int
    label: int


class Observer:
    """Makes observations of one kind, and knows their space."""

    def __init__(self, keys: Sequence[str], camera: Camera, max_clutter: int, labels: int) -> None:
        """Choose the keys.

        Args:
            keys: Observation keys, in order.
            camera: The view of all images.
            max_clutter: Largest number of non-target objects; the offsets are padded to it.
            labels: Number of names in the object set.

        Raises:
            MechSearchError: If a key is unknown.
        """
        unknown = [key for key in keys if key not in KEYS]
        if unknown:
            raise MechSearchError(
                f"unknown observation key {unknown[0]!r}; choose among {', '.join(KEYS)}"
            )
        self.keys = tuple(keys)
        self.camera = camera
        self.needs_images = bool(IMAGE_KEYS & set(keys))
        self.needs_colour = "rgb" in keys
        self._max_clutter = max_clutter
        self._labels = labels
        sides = {"H": camera.height, "W": camera.width, "N": max_clutter, "L": labels}
        spaces: dict[str, gymnasium.Space[Any]] = {k: KINDS[k].space(**sides) for k in keys}
        if "clutter_mask" in spaces:
            spaces["clutter_mask"] = gymnasium.spaces.MultiBinary(max_clutter)
        self.space = gymnasium.spaces.Dict(spaces)

    def observe(self, scene: Scene) -> dict[str, Array]:
        """Return a fresh observation (see `types` for its keys)."""
        return {key: getattr(self, f"_{key}")(scene) for key in self.keys}

    def _depth(self, scene: Scene) -> Array:
        return np.asarray(without_holes(scene.depth), np.float16)[None]

    def _position_image(self, scene: Scene) -> Array:
        mask, depth = np.asarray(scene.target_mask), np.asarray(scene.depth)
        return position_image(mask, depth, self.camera, scene.ee_position)

    def _rgb(self, scene: Scene) -> Array:
        return np.ascontiguousarray(np.moveaxis(np.asarray(scene.rgb), -1, 0))

    def _target_label(self, scene: Scene) -> Array:
        label: Array = np.zeros(self._labels, np.float32)
        label[scene.label] = 1.0
        return label

    def _ee_position(self, scene: Scene) -> Array:
        return np.asarray(scene.ee_position, np.float32)

    def _target_offset(self, scene: Scene) -> Array:
        return np.asarray(scene.positions[scene.target] - scene.effector, np.float32)

    def _clutter_offsets(self, scene: Scene) -> Array:
        rest = others(scene.target, len(scene.positions))
        offsets = np.zeros((self._max_clutter, 3), np.float32)
        away = scene.positions[rest] - scene.effector
        offsets[: len(rest)] = away * scene.present[rest, None]
        return offsets

    def _clutter_mask(self, scene: Scene) -> Array:
        mask = np.zeros(self._max_clutter, np.int8)
        rest = others(scene.target, len(scene.positions))
        mask[: len(rest)] = scene.present[rest]
        return mask


@lru_cache(maxsize=1024)
def others(target: int, count: int) -> NDArray[np.intp]:
    """Return the indices of all `count` objects but the target (count - 1,)."""
    return np.delete(np.arange(count), target)


def position_image(
    mask: Array, depth: Array, camera: Camera, ee_position: Array
) -> NDArray[np.float16]:
    """Return the offset from end effector to target of every visible target pixel.

    It is the mid-level representation of the paper (section III-B).

    Args:
        mask: Visible target pixels (H, W) bool.
        depth: Depth image (H, W) [m]; its holes, as in `without_holes`, are left out.
        camera: Intrinsics and pose of the image.
        ee_position: End effector (3,) [m], world frame.

    Returns:
        Offsets (3, H, W) [m] in world axes, 0 off the target.

    Raises:
        MechSearchError: If mask, depth and camera differ in size.
    """
    shape = (camera.height, camera.width)
    if mask.shape != shape or depth.shape != shape:
        raise MechSearchError(
            f"mask {mask.shape} and depth {depth.shape} must both be the camera's {shape}"
        )
    image = np.zeros((3, *shape), np.float16)
    pixels = mask.ravel().nonzero()[0]
    z = depth.take(pixels)
    measured = (z > 0) & (z < np.inf)
    if not measured.all():
        pixels, z = pixels[measured], z[measured]
    origin, rays = _rays(camera)
    offsets = rays.take(pixels, axis=1) * z + (origin - ee_position)[:, None]
    image.reshape(3, -1)[:, pixels] = offsets
    return image


@lru_cache(maxsize=8)
def _rays(camera: Camera) -> tuple[Floats, Floats]:
    """Return where the camera is (3,), and its pixels' rays (3, H W) in world axes."""
    pose = camera.pose
    rays = camera.directions().reshape(-1, 3) @ pose[:3, :3].T
    return pose[:3, 3], np.ascontiguousarray(rays.T)


def without_holes(depth: Any, name: str = "depth") -> Array:
    """Return a depth image as a policy reads it: the one way to take a camera's image.

    Holes are pixels that are not above 0 or not finite, as depth cameras give them where they
    measure nothing. Each takes the depth of the nearest pixel that has one. An image without holes
    is returned as it is.

    Args:
        depth: (H, W) or (1, H, W), floating-point numbers [m].
        name: What it is called in errors.

    Raises:
        MechSearchError: If it is no image in metres, or half of it or more are holes.
    """
    image, measured = _measured(depth, name)
    if measured is None:
        return image
    holes = 1.0 - float(measured.mean())
    if holes >= MOST_HOLES:
        raise MechSearchError(
            f"{name} has no depth, 0 or not finite, in {holes:.0%} of its pixels; expected less "
            f"than {MOST_HOLES:.0%}"
        )
    _check_metres(image[measured], name)
    if not holes:
        return image
    flat = image.reshape(image.shape[-2:])
    nearest = distance_transform_edt(
        ~measured.reshape(flat.shape), return_distances=False, return_indices=True
    )
    return np.asarray(flat[tuple(nearest)].reshape(image.shape))


def _measured(depth: Any, name: str) -> tuple[Array, NDArray[np.bool_] | None]:
    """Return a depth image, and which of its pixels are no holes; None if all are within range."""
    image = real_array(depth, f"{name} is a depth image in metres")
    if image.dtype.kind != "f":
        raise MechSearchError(
            f"{name} is of {image.dtype.name}: is it in millimetres? expected metres, as "
            "floating-point numbers"
        )
    if image.ndim < 2 or not image.size:
        raise MechSearchError(f"{name} has shape {image.shape}; expected an image (H, W)")
    if image.min() > 0 and image.max() <= FARTHEST:
        return image, None
    return image, (image > 0) & (image < np.inf)


def _check_metres(depths: Array, name: str) -> None:
    middle = float(np.median(depths.astype(np.float64)))
    if middle > FARTHEST:
        raise MechSearchError(
            f"{name} is {middle:.0f} in the median: is it in millimetres? expected metres, up to "
            f"{FARTHEST:g}"
        )


@dataclass(frozen=True)
class Reprojection:
    """What one camera would have seen, as far as another one saw it.

    Attributes:
        depth: (H, W) float32 [m], 0 in holes: where the other camera saw nothing.
        mask: (H, W) bool, false in holes; None if none was given.
        colour: (H, W, 3) uint8, 0 in holes; None if none was given.
    """

    depth: Array
    mask: Array | None
    colour: Array | None


def reproject(
    depth: Any, camera: Camera, view: Camera, mask: Any = None, colour: Any = None
) -> Reprojection:
    """Return the images of any calibrated camera in the view that a policy knows.

    Surfaces are sampled densely enough for the view, between pixels too unless there is an edge; of
    what falls into one of its pixels the nearest surface prevails, sampled next to the middle.
    Holes are left to `without_holes`, as of any camera.

    Args:
        depth: (H, W), floating-point numbers [m]; holes as in `without_holes`, in any number.
        camera: Intrinsics and pose of that image.
        view: Of the policy, such as `camera.preset(policy.camera, policy.image_size)`.
        mask: Pixels of the target (H, W) bool in the same image.
        colour: (H, W, 3) uint8, likewise.

    Raises:
        MechSearchError: If images and camera differ in size, the camera is below the table, which
            is at height 0, or looks away from it, all of the image is holes, or nothing of it is in
            the view.
    """
    shape = (camera.height, camera.width)
    image, measured = _measured(depth, "depth")
    if image.shape != shape:
        raise MechSearchError(f"depth has shape {image.shape}; this camera's is {shape}")
    beside = {"mask": (mask, shape), "colour": (colour, (*shape, 3))}
    for name, (given, expected) in beside.items():
        if given is not None and np.shape(given) != expected:
            raise MechSearchError(f"{name} has shape {np.shape(given)}; expected {expected}")
    place, ahead = camera.pose[:3, 3], camera.pose[:3, 2]
    if place[2] <= 0:
        raise MechSearchError(
            f"the camera is at {_metres(place)} m, below the table; expected a height above 0: is "
            "its pose the camera's in the world?"
        )
    if ahead[2] >= 0:
        raise MechSearchError(
            f"the camera looks along {_metres(ahead).replace(' m', '')}, away from the table; "
            "expected downwards: its z axis is the optical axis"
        )
    if measured is None:
        measured = np.ones(shape, np.bool_)
    if not measured.any():
        raise MechSearchError("depth has no depth, 0 or not finite, in any of its pixels")
    _check_metres(image[measured], "depth")
    near, found = _into(np.where(measured, image, 0).astype(np.float64), camera, view)
    if not (found >= 0).any():
        raise MechSearchError(
            f"nothing that the camera at {_metres(place)} m sees is in the view of the policy's "
            f"camera at {_metres(view.pose[:3, 3])} m; expected both to see the table"
        )
    holes = found < 0

    def taken(values: Any, kind: Any) -> Array | None:
        if values is None:
            return None
        array = np.asarray(values, kind)
        picked: Array = array.reshape(-1, *array.shape[2:])[found]
        picked[holes] = 0
        return picked

    return Reprojection(near, taken(mask, np.bool_), taken(colour, np.uint8))


def _into(depth: Floats, camera: Camera, view: Camera) -> tuple[Array, NDArray[np.intp]]:
    """Return depth (H, W) [m] in a view, 0 in holes, and the pixel seen there; -1 in holes."""
    inverse = np.divide(1.0, depth, out=np.zeros_like(depth), where=depth > 0)
    # A pixel with its neighbours on the right, below, and beyond: one over depth is linear in it.
    padded = np.pad(inverse, ((0, 1), (0, 1)))
    corners = np.stack([padded[:-1, :-1], padded[:-1, 1:], padded[1:, :-1], padded[1:, 1:]])
    low = corners.min(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        smooth = (low > 0) & (1 / low - 1 / corners.max(axis=0) <= _step(depth, camera))
    pixels = np.flatnonzero(inverse)
    pixels = pixels[~_under_the_table(pixels, depth.ravel()[pixels], camera, view)]
    between, around = smooth.ravel()[pixels], corners.reshape(4, -1)[:, pixels]
    onto = np.linalg.inv(view.pose) @ camera.pose
    times = _samples(onto, pixels[between], around[:, between], camera, view)
    best = np.full(view.width * view.height, np.inf)
    fallen = []
    for a, b in product(np.arange(times) / times, repeat=2):
        use = between if a or b else np.ones(len(pixels), np.bool_)
        weights = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
        z = 1 / sum(w * one[use] for w, one in zip(weights, around, strict=True))
        u, v, z = _projected(_placed(onto, pixels[use], z, camera, a, b), view)
        seen = (z > 0) & (np.abs(u - (view.width - 1) / 2) < view.width / 2)
        seen &= np.abs(v - (view.height - 1) / 2) < view.height / 2
        u, v, z = u[seen], v[seen], z[seen]
        place = np.rint(v).astype(np.intp) * view.width + np.rint(u).astype(np.intp)
        np.minimum.at(best, place, z)
        source = pixels[use][seen] + (a >= 0.5) + (b >= 0.5) * camera.width
        fallen.append((place, z, source, np.hypot(u - np.rint(u), v - np.rint(v))))
    place, z, source, away = map(np.concatenate, zip(*fallen, strict=True))
    front = z <= best[place] + _step(best[place], view)
    # The last of those in one place is written: the one next to its middle.
    order = front.nonzero()[0][np.argsort(-away[front], kind="stable")]
    found, near = np.full(len(best), -1, np.intp), np.zeros(len(best), np.float32)
    found[place[order]], near[place[order]] = source[order], z[order]
    shape = (view.height, view.width)
    return near.reshape(shape), found.reshape(shape)


def _placed(
    onto: Floats, pixels: Array, depth: Floats, camera: Camera, right: float = 0, down: float = 0
) -> list[Floats]:
    """Return x, y and z (K,) in another frame of points beside pixels, by their flat indices."""
    x = (pixels % camera.width + right - camera.cx) / camera.fx
    y = (pixels // camera.width + down - camera.cy) / camera.fy
    # Not as a product of matrices: on a busy machine, threads for so narrow ones are slow.
    return [depth * (row[0] * x + row[1] * y + row[2]) + row[3] for row in onto[:3]]


def _projected(place: list[Floats], view: Camera) -> tuple[Floats, Floats, Floats]:
    """Return column, row [px] and depth of points in a camera's frame."""
    x, y, z = place
    ahead = np.where(z > 0, z, 1.0)
    return view.fx * x / ahead + view.cx, view.fy * y / ahead + view.cy, z


def _under_the_table(pixels: Array, depth: Floats, camera: Camera, view: Camera) -> Array:
    """Return which pixels show what the table hides from a view, such as the floor beside it."""
    x, y, z = _placed(camera.pose, pixels, depth, camera)
    eye = view.pose[:3, 3]
    share = eye[2] / np.maximum(eye[2] - z, 1e-9)
    over = np.maximum(np.abs(eye[0] + share * (x - eye[0])), np.abs(eye[1] + share * (y - eye[1])))
    hidden: Array = (z < -_TABLE_ERROR) & (over <= _TABLE_HALF)
    return hidden


def _step(depth: Floats, camera: Camera) -> Floats:
    """Return the greatest difference in depth [m] between neighbours on one surface."""
    return 0.005 + 2.0 * depth / camera.fx


def _samples(onto: Floats, pixels: Array, around: Floats, camera: Camera, view: Camera) -> int:
    """Return how many samples a pixel's side needs so that none of a view's pixels is passed over.

    Args:
        onto: From the camera's frame to that of the view.
        pixels: Flat indices (K,) of pixels on smooth surfaces.
        around: One over depth (4, K) of them, the next ones right and below, and a fourth.
        camera: Of these.
        view: Where they are to be seen.
    """
    some = slice(None, None, max(1, len(pixels) // 1000))
    here, right, below = (
        np.array(_projected(_placed(onto, pixels[some], 1 / one[some], camera, *at), view))
        for one, at in zip(around, ((0, 0), (1, 0), (0, 1)), strict=False)
    )
    apart = np.hypot(*(np.stack([right, below], axis=1)[:2] - here[:2, None]))[:, here[2] > 0]
    # Squares of this side lie over every pixel, however they are turned.
    widest = float(np.quantile(apart, 0.99)) * np.sqrt(2) if apart.size else 1.0
    return int(np.clip(np.ceil(widest), 1, _MOST_SAMPLES))


def readable(
    obs: Any,
    keys: Sequence[str],
    image_size: int | None = None,
    clip: Callable[[Array], Floats] | None = None,
) -> dict[str, Array]:
    """Return what a policy may read of an observation from anywhere, such as from a robot.

    What an environment returns comes back as it is. Lists and tensors become arrays, and depth
    images lose their holes, see `without_holes`.

    Args:
        obs: By key.
        keys: Those that the policy reads.
        image_size: Side of its images [px], where it is known.
        clip: Returns the nearest position (3,) [m] in the workspace.

    Raises:
        MechSearchError: Naming the key, what it holds, and what was expected.
    """
    if not isinstance(obs, Mapping):
        raise MechSearchError(
            f"an observation is a {type(obs).__name__}; expected arrays by key: {', '.join(keys)}"
        )
    sides = {} if image_size is None else {"H": image_size, "W": image_size}
    seen = select(obs, tuple(keys))
    return {key: _read(key, value, sides, clip) for key, value in seen.items()}


def _read(
    key: str, value: Any, sides: dict[str, int], clip: Callable[[Array], Floats] | None
) -> Array:
    """Return what a key holds, checked; learn the sides that stand for letters."""
    if key not in KINDS:
        return np.asarray(value)
    kind = KINDS[key]
    array = real_array(value, f"{key} is {kind}")
    shape = tuple(sides.get(str(side), side) for side in kind.shape)
    fits = len(shape) == array.ndim and all(
        isinstance(side, str) or side == own for side, own in zip(shape, array.shape, strict=True)
    )
    if not fits or not array.size:
        expected = str(shape).replace("'", "")
        raise MechSearchError(f"{key} has shape {array.shape}; expected {expected}: {kind.meaning}")
    sides |= {
        side: own
        for side, own in zip(kind.shape, array.shape, strict=True)
        if isinstance(side, str)
    }
    if key in ("depth", "grasp_depth"):
        return without_holes(array, key)
    if array.dtype.kind == "f" and not np.issubdtype(kind.dtype, np.floating):
        raise MechSearchError(f"{key} is of {array.dtype.name}; expected {kind}")
    if key == "ee_position" and clip is not None and np.isfinite(array).all():
        nearest = clip(array)
        away = float(np.abs(array - nearest).max())
        if away > _BESIDE:
            raise MechSearchError(
                f"ee_position is {_metres(array)} m, {away:.3f} m outside the workspace; the "
                f"nearest position in it is {_metres(nearest)}"
            )
    if not (array.min() >= kind.low and array.max() <= kind.high):
        wrong = array[~((array >= kind.low) & (array <= kind.high))]
        raise MechSearchError(
            f"{key} holds {wrong[0]} in {wrong.size} of {array.size} places; expected {kind}"
        )
    return array


def _metres(position: Array) -> str:
    return f"({', '.join(f'{number:.3f}' for number in position.tolist())})"
