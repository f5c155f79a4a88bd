"""A user's own depth image, mask and intrinsics, from NPZ, NPY, PNG and JSON files."""

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, UnidentifiedImageError

from mechsearch.camera import Camera
from mechsearch.files import ARRAY_DAMAGE, read_json
from mechsearch.grasp.view import GraspView, view_of_image
from mechsearch.types import Array, MechSearchError

_LEVEL = tuple(np.eye(4).ravel().tolist())


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
        numbers = [k[0, 0], k[1, 1], k[0, 2], k[1, 2]]
    else:
        numbers = _numbers(intrinsics)
    fx, fy, cx, cy = (float(number) for number in numbers)
    return view_of_image(image, inside, Camera(width, height, fx, fy, cx, cy, _LEVEL))


def _within(depth: Path, what: str) -> Path:
    if depth.suffix != ".npz":
        raise MechSearchError(f"{depth} holds a depth image alone; name a file for the {what} too")
    return depth


def _array(path: Path, name: str) -> Array:
    if not path.is_file():
        raise MechSearchError(f"no {name} at {path}")
    try:
        if path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as file:
                if name not in file.files:
                    raise MechSearchError(
                        f"{path} has no array {name!r}; it has {', '.join(file.files)}"
                    )
                return np.asarray(file[name])
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
