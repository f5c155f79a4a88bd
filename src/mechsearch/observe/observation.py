"""Assembles one observation, with just the keys that were asked for, and reads a robot's own."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from mechsearch.camera import Camera
from mechsearch.types import (
    Array,
    Floats,
    MechSearchError,
    Observation,
    real_array,
    select,
)

REACH = 2.0
"""Bound on every coordinate and offset [m]."""

FARTHEST = 10.0
"""Bound on every depth [m]."""

MOST_HOLES = 0.5
"""Share of a depth image from which on it is refused for its holes."""

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
        self.needs_colour = "rgb" in keys
        self._max_clutter = max_clutter
        self._labels = labels
        sides = {"H": camera.height, "W": camera.width, "N": max_clutter, "L": labels}
        spaces: dict[str, gymnasium.Space[Any]] = {k: KINDS[k].space(**sides) for k in keys}
        if "clutter_mask" in spaces:
            spaces["clutter_mask"] = gymnasium.spaces.MultiBinary(max_clutter)
        self.space = gymnasium.spaces.Dict(spaces)

    def observe(self, scene: Scene, keys: Iterable[str] | None = None) -> dict[str, Array]:
        """Return a fresh observation (see `types` for its keys), or some keys of one."""
        asked = self.keys if keys is None else keys
        return {key: getattr(self, f"_{key}")(scene) for key in asked}

    def _depth(self, scene: Scene) -> Array:
        return np.asarray(without_holes(scene.depth, most=1.0), np.float16)[None]

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


class OnDemand(Mapping[str, Array]):
    """An observation whose images are made when one is first read."""

    def __init__(
        self, made: Mapping[str, Array], images: Sequence[str], make: Callable[[], Observation]
    ) -> None:
        """Take what is known already, the keys of images, and what makes these."""
        self._made, self._images, self._make = dict(made), tuple(images), make

    def __getitem__(self, key: str) -> Array:
        if key in self._images and key not in self._made:
            images = self._make()
            self._made |= {image: images[image] for image in self._images}
        return self._made[key]

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys((*self._made, *self._images)))

    def __len__(self) -> int:
        return len({*self._made, *self._images})

    def only(self, keys: Sequence[str]) -> "OnDemand":
        """Return the part of it that one policy may read."""
        made = {key: value for key, value in self._made.items() if key in keys}
        return OnDemand(made, [key for key in self._images if key in keys], self._make)


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


def without_holes(depth: Any, name: str = "depth", most: float = MOST_HOLES) -> Array:
    """Return a depth image as a policy reads it: the one way to take a camera's image.

    Holes are pixels that are not above 0 or not finite, as depth cameras give them where they
    measure nothing. Each takes the depth of the nearest pixel that has one. An image without holes
    is returned as it is.

    Args:
        depth: (H, W) or (1, H, W), floating-point numbers [m].
        name: What it is called in errors.
        most: Share of holes from which on it is refused; 1 for a simulated sensor, which may lose
            more than is accepted of a camera, and the episode goes on.

    Raises:
        MechSearchError: If it is no image in metres, or so much of it are holes.
    """
    image, measured = measured_pixels(depth, name)
    if measured is None:
        return image
    holes = 1.0 - float(measured.mean())
    if holes >= most:
        raise MechSearchError(
            f"{name} has no depth, 0 or not finite, in {holes:.0%} of its pixels; expected less "
            f"than {most:.0%}"
        )
    check_metres(image[measured], name)
    if not holes:
        return image
    flat = image.reshape(image.shape[-2:])
    nearest = distance_transform_edt(
        ~measured.reshape(flat.shape), return_distances=False, return_indices=True
    )
    return np.asarray(flat[tuple(nearest)].reshape(image.shape))


def measured_pixels(depth: Any, name: str) -> tuple[Array, NDArray[np.bool_] | None]:
    """Return a depth image, and which of its pixels are no holes; None if all are within range.

    Raises:
        MechSearchError: If it is no image of floating-point numbers.
    """
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


def check_metres(depths: Array, name: str) -> None:
    """Refuse measured depths (K,), at least one, that are too great to be metres.

    Raises:
        MechSearchError: Asking whether they are in millimetres.
    """
    middle = float(np.median(depths.astype(np.float64)))
    if middle > FARTHEST:
        raise MechSearchError(
            f"{name} is {middle:.0f} in the median: is it in millimetres? expected metres, up to "
            f"{FARTHEST:g}"
        )


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
