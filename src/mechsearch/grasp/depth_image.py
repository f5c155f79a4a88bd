"""A user's own depth image, mask and intrinsics: from files, checked and filled."""

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, UnidentifiedImageError

from mechsearch.camera import Camera
from mechsearch.files import ARRAY_DAMAGE, read_arrays, read_json
from mechsearch.grasp.grasp_view import NETWORK_OPENING, GraspView
from mechsearch.types import Array, MechSearchError

_WIDTH_PX = (23.0, 46.0)
"""Width of a 5 cm gripper at the target [px]: where the released network's scores were found
steady; 0.8 m below the metric camera it is 34.5."""


def read_view(
    depth: Path, mask: Path | None, intrinsics: Path | None, scale: float = 1.0
) -> GraspView:
    """Return the view that files hold.

    Args:
        depth: Depth image: NPY, PNG, or NPZ with an array `depth`, and perhaps `mask` and `K`.
        mask: The target: NPY, PNG, or NPZ with an array `mask`; None takes it from the depth's NPZ.
        intrinsics: JSON with fx, fy, cx, cy [px]; None takes `K` (3, 3) from the depth's NPZ.
        scale: Metres for one unit of the depth image, 0.001 for millimetres.

    Raises:
        MechSearchError: If a file is missing or damaged, lacks something, or `view_of_image`
            refuses what it holds.
    """
    image = _array(depth, "depth").astype(np.float32) * np.float32(scale)
    inside = _array(mask or _within(depth, "mask"), "mask")
    height, width = image.shape[:2] if image.ndim >= 2 else (0, 0)
    if intrinsics is None:
        k = np.asarray(_array(_within(depth, "intrinsics"), "K"), np.float64)
        if k.shape != (3, 3):
            raise MechSearchError(f"K in {depth} has shape {k.shape}; expected (3, 3)")
        numbers = k[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()
    else:
        numbers = _numbers(intrinsics)
    fx, fy, cx, cy = map(float, numbers)
    level = tuple(np.eye(4).ravel().tolist())
    return view_of_image(image, inside, Camera(width, height, fx, fy, cx, cy, level))


def view_of_image(depth: Array, mask: Array, camera: Camera) -> GraspView:
    """Return a user's depth image, checked and filled.

    Holes (0 or not finite) take the median of the other pixels, and are no part of the target.

    Args:
        depth: (H, W) or (H, W, 1) [m].
        mask: The target (H, W) or (H, W, 1), bool or 0 where it is not.
        camera: Its size must be the image's.

    Raises:
        MechSearchError: If sizes differ, depths are no metres, most of the image is holes, no pixel
            of the target is visible, or the target is too near or far for the networks.
    """
    raw, inside = _flat("depth image", depth), _flat("mask", mask) != 0
    if inside.shape != raw.shape:
        raise MechSearchError(f"the mask is {inside.shape}, the depth image {raw.shape}")
    if (camera.height, camera.width) != raw.shape:
        raise MechSearchError(
            f"the depth image is {raw.shape}, but the intrinsics are for "
            f"{(camera.height, camera.width)}"
        )
    metres = raw.astype(np.float32)
    seen = np.isfinite(metres) & (metres > 0)
    holes = 1 - seen.mean()
    if holes > 0.75:
        raise MechSearchError(
            f"{holes:.0%} of the depth image are holes (0 or not finite); expected less than 75%"
        )
    middle = float(np.median(metres[seen]))
    if middle > 20.0:
        raise MechSearchError(
            f"the median depth is {middle:.0f}; expected metres, so divide millimetres by 1000"
        )
    inside = inside & seen
    if not inside.any():
        raise MechSearchError("the mask has no pixel with a depth: no target is visible")
    width = camera.fx * NETWORK_OPENING[0] / float(np.median(metres[inside]))
    if not _WIDTH_PX[0] <= width <= _WIDTH_PX[1]:
        raise MechSearchError(
            f"at the target a 5 cm gripper is {width:.0f} px wide; the networks know "
            f"{_WIDTH_PX[0]:.0f} to {_WIDTH_PX[1]:.0f} px, so resize image, mask and intrinsics by "
            f"about {34.5 / width:.2f}"
        )
    filled = np.where(seen, metres, np.float32(middle)).astype(np.float32)
    return GraspView(filled, inside, camera, float(filled.max()))


def _within(depth: Path, what: str) -> Path:
    if depth.suffix != ".npz":
        raise MechSearchError(f"{depth} holds a depth image alone; name a file for the {what} too")
    return depth


def _array(path: Path, name: str) -> Array:
    if not path.is_file():
        raise MechSearchError(f"no {name} at {path}")
    if path.suffix == ".npz":
        arrays = read_arrays(path, name)
        if name not in arrays:
            raise MechSearchError(f"{path} has no array {name!r}; it has {', '.join(arrays)}")
        return arrays[name]
    try:
        if path.suffix == ".npy":
            return np.asarray(np.load(path, allow_pickle=False))
        with Image.open(path) as image:
            # Alpha and colour say nothing about depth or membership: the first channel counts.
            array = np.asarray(image)
            return array[..., 0] if array.ndim == 3 else array
    except (*ARRAY_DAMAGE, UnidentifiedImageError) as error:
        raise MechSearchError(f"the {name} at {path} is damaged: {error}") from None


def _numbers(path: Path) -> list[Any]:
    found = read_json(path, "intrinsics")
    names = ("fx", "fy", "cx", "cy")
    if not isinstance(found, dict):
        raise MechSearchError(f"{path} is no JSON object with {', '.join(names)}")
    numbers = [found.get(name, found.get(f"_{name}")) for name in names]
    wrong = [n for n, v in zip(names, numbers, strict=True) if not isinstance(v, int | float)]
    if wrong:
        raise MechSearchError(f"{path} lacks a number for {', '.join(wrong)} [px]")
    return numbers


def _flat(name: str, image: Array) -> Array:
    array = np.asarray(image)
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[..., 0]
    if array.ndim != 2:
        raise MechSearchError(f"the {name} has shape {array.shape}; expected (H, W)")
    return array
