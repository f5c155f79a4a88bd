"""Assembles one observation, with just the keys that were asked for."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from mechsearch.camera import Camera
from mechsearch.types import IMAGE_KEYS, Array, Floats, MechSearchError

KEYS = (
    *("depth", "position_image", "rgb", "target_label"),
    *("ee_position", "target_offset", "clutter_offsets", "clutter_mask"),
)


@dataclass(frozen=True)
class Scene:
    """What an observation is made of.

    Attributes:
        depth: Depth image (H, W) [m], or None when no image is asked for.
        target_mask: Visible target pixels (H, W), or None likewise.
        rgb: Colour image (H, W, 3), or None when not asked for.
        ee_position: End effector (3,) [m].
        positions: Centres of mass of all objects (N, 3) [m].
        present: Which objects are still on the table (N,).
        target: Index of the target.
        label: Index of the target among the object set's names.
    """

    depth: Array | None
    target_mask: Array | None
    rgb: Array | None
    ee_position: Floats
    positions: Floats
    present: Array
    target: int
    label: int


class Observer:
    """Makes observations of one kind, and knows their space."""

    def __init__(
        self, keys: Sequence[str], camera: Camera, max_clutter: int, labels: int, reach: float
    ) -> None:
        """Choose the keys.

        Args:
            keys: Observation keys, in order.
            camera: The view of all images.
            max_clutter: Largest number of non-target objects; the offsets are padded to it.
            labels: Number of names in the object set.
            reach: Bound on every coordinate and offset [m].

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
        size = (camera.height, camera.width)
        box = gymnasium.spaces.Box
        spaces: dict[str, gymnasium.Space[Any]] = {
            "depth": box(0.0, 10.0, (1, *size), np.float16),
            "position_image": box(-reach, reach, (3, *size), np.float16),
            "rgb": box(0, 255, (3, *size), np.uint8),
            "target_label": box(0.0, 1.0, (labels,), np.float32),
            "ee_position": box(-reach, reach, (3,), np.float32),
            "target_offset": box(-reach, reach, (3,), np.float32),
            "clutter_offsets": box(-reach, reach, (max_clutter, 3), np.float32),
            "clutter_mask": gymnasium.spaces.MultiBinary(max_clutter),
        }
        self.space = gymnasium.spaces.Dict({key: spaces[key] for key in keys})

    def observe(self, scene: Scene) -> dict[str, Array]:
        """Return a fresh observation (see `types` for its keys)."""
        return {key: getattr(self, f"_{key}")(scene) for key in self.keys}

    def _depth(self, scene: Scene) -> Array:
        return np.asarray(scene.depth, np.float16)[None]

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
        return np.asarray(scene.positions[scene.target] - scene.ee_position, np.float32)

    def _clutter_offsets(self, scene: Scene) -> Array:
        rest = others(scene.target, len(scene.positions))
        offsets = np.zeros((self._max_clutter, 3), np.float32)
        away = scene.positions[rest] - scene.ee_position
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
        depth: Depth image (H, W) [m]; pixels without a measurement are 0 and are left out.
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
    if not z.all():
        pixels, z = pixels[z > 0], z[z > 0]
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
