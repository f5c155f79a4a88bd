"""Cameras as people keep them: four numbers or a matrix, in JSON, YAML, text or arrays; checked."""

import json
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mechsearch.camera import Camera
from mechsearch.files import ARRAY_DAMAGE
from mechsearch.grasp.image_files import read_stored
from mechsearch.types import Floats, MechSearchError

_NUMBERS = {
    "fx": ("fx", "_fx", "fl_x"),
    "fy": ("fy", "_fy", "fl_y"),
    "cx": ("cx", "_cx", "ppx"),
    "cy": ("cy", "_cy", "ppy"),
}
_MATRICES = ("K", "k", "camera_matrix", "cameraMatrix", "intrinsic_matrix")
_SIZES = {
    "width": ("width", "_width", "image_width", "w"),
    "height": ("height", "_height", "image_height", "h"),
}
_DISTORTION = (
    *("D", "d", "coeffs", "distortion_coefficients", "distortion", "dist_coeffs", "distCoeffs"),
    *("dist", "k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"),
)
_SPELLINGS = "fx, fy, cx (or ppx) and cy (or ppy), or a matrix K or camera_matrix"

_FOCAL_LENGTHS = (0.2, 50.0)
"""Of cameras, in widths of their images: from 136 degrees of view to 1."""


def read_camera(path: Path, shape: tuple[int, int]) -> Camera:
    """Return the camera that a file describes, at the origin and looking along z.

    Args:
        path: JSON; YAML, such as a ROS CameraInfo, a calibration of ROS or OpenCV; text of a
            matrix; NPY; or NPZ. See `camera_of` for what it may hold.
        shape: Of the camera's image: rows, columns.

    Raises:
        MechSearchError: If the file is missing or damaged, or `camera_of` refuses what it holds.
    """
    if not path.is_file():
        raise MechSearchError(f"no intrinsics at {path}")
    try:
        with path.open("rb") as file:
            head = file.read(6)
        if head.startswith(b"PK") or head == b"\x93NUMPY":
            return camera_of(read_stored(path, "intrinsics"), shape, str(path))
        return camera_of(_parsed(path.read_text("utf-8-sig")), shape, str(path))
    except (*ARRAY_DAMAGE, AttributeError, yaml.YAMLError) as error:
        if isinstance(error, MechSearchError):
            raise
        raise MechSearchError(
            f"the intrinsics at {path} are damaged, or no JSON, YAML or matrix: {error}"
        ) from None


def camera_of(found: Any, shape: tuple[int, int], where: str) -> Camera:
    """Return the camera that names and numbers describe, at the origin and looking along z.

    Args:
        found: By name, perhaps under one name more: `fx`, `fy`, `cx` or `ppx`, `cy` or `ppy`; or a
            matrix (3, 3) or of 9 numbers, `K` or `camera_matrix`; with or without the image's size
            and the distortion. Or the matrix alone. A transposed matrix is understood.
        shape: Of the camera's image: rows, columns.
        where: What `found` is from, for errors.

    Raises:
        MechSearchError: If a number is missing, contradicts another, or is no camera's; or if the
            image has another size.
    """
    if isinstance(found, list | np.ndarray):
        found = {"K": found}
    if not isinstance(found, Mapping):
        raise MechSearchError(f"{where} has no names; expected {_SPELLINGS}")
    inner = [value for value in found.values() if isinstance(value, Mapping) and _is_camera(value)]
    if not _is_camera(found) and len(inner) == 1:
        found = inner[0]
    numbers = _present(found, _NUMBERS)
    for name in (name for name in _MATRICES if name in found):
        for key, value in _of_matrix(found[name], name, where).items():
            if abs(numbers.setdefault(key, value) - value) > 1e-3:
                raise MechSearchError(
                    f"{where} has {key} {numbers[key]:g}, and {value:g} in {name}"
                )
    if missing := [name for name in _NUMBERS if name not in numbers]:
        raise MechSearchError(
            f"{where} lacks {', '.join(missing)}; it has {', '.join(map(str, found)) or 'nothing'}"
            f"; expected {_SPELLINGS}"
        )
    height, width = shape
    declared = _present(found, _SIZES)
    if {"width": width, "height": height} | declared != {"width": width, "height": height}:
        said = " and ".join(f"{key} {value:g}" for key, value in declared.items())
        raise MechSearchError(
            f"{where} is for an image of {said}, but the depth image has {width} x {height} px; "
            "bring the camera of this image"
        )
    _check(numbers, width, height, bool(declared), where)
    _name_distortion(found, where)
    level = tuple(np.eye(4).ravel().tolist())
    return Camera(width, height, **numbers, world_from_camera=level)


def _parsed(text: str) -> Any:
    """Return what text holds: JSON, the first document of YAML, or a matrix."""
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        # OpenCV writes a first line that is no YAML, and a tag of its own.
        body = text.partition("\n")[2] if text.startswith("%YAML:") else text
        found = next(yaml.safe_load_all(body.replace("!!opencv-matrix", "")), None)
    return [float(word) for word in found.split()] if isinstance(found, str) else found


def _is_camera(found: Mapping[Any, Any]) -> bool:
    return any(name in found for names in (_MATRICES, *_NUMBERS.values()) for name in names)


def _present(found: Mapping[Any, Any], keys: Mapping[str, tuple[str, ...]]) -> dict[str, float]:
    """Return the numbers that are there under one of their names."""
    values = {}
    for key, names in keys.items():
        for name in (name for name in names if name in found):
            if (array := _array(found[name], name)).size != 1:
                raise MechSearchError(f"{name} is {array.tolist()}; expected one number")
            values[key] = float(array.item())
    return values


def _of_matrix(value: Any, name: str, where: str) -> dict[str, float]:
    matrix = _array(value, name)
    if matrix.size != 9:
        raise MechSearchError(f"{name} in {where} has shape {matrix.shape}; expected (3, 3)")
    matrix = matrix.reshape(3, 3)
    if matrix[2, 0] or matrix[2, 1]:
        matrix = matrix.T
    fx, fy = matrix[0, 0], matrix[1, 1]
    if not np.array_equal(matrix, [[fx, 0, matrix[0, 2]], [0, fy, matrix[1, 2]], [0, 0, 1]]):
        raise MechSearchError(
            f"{name} in {where} is no camera's matrix: {matrix.tolist()}; expected "
            "[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"
        )
    return dict(zip(_NUMBERS, (fx, fy, *matrix[:2, 2]), strict=True))


def _array(value: Any, name: str) -> Floats:
    """Return the numbers under a name, also where they are the data of ROS or OpenCV."""
    data = value.get("data", value) if isinstance(value, Mapping) else value
    try:
        array = np.asarray(data, np.float64)
        if data is None or isinstance(data, bool):
            raise TypeError
    except (TypeError, ValueError):
        raise MechSearchError(f"{name} is {data!r}; expected numbers") from None
    return array


def _check(
    numbers: Mapping[str, float], width: int, height: int, declared: bool, where: str
) -> None:
    """Refuse numbers that are no camera's."""
    fx, fy, cx, cy = (numbers[name] for name in _NUMBERS)
    low, high = (share * max(width, height) for share in _FOCAL_LENGTHS)
    said = f"{where} has fx {fx:g}, fy {fy:g}, cx {cx:g}, cy {cy:g}, for {width} x {height} px"
    if not np.isfinite([fx, fy, cx, cy]).all():
        raise MechSearchError(f"{said}; expected finite numbers")
    if not (low <= fx <= high and low <= fy <= high):
        raise MechSearchError(f"{said}; expected focal lengths of {low:.0f} to {high:.0f} px")
    if not 0.9 <= fx / fy <= 1.1:
        raise MechSearchError(f"{said}; expected square pixels, so resize until fx and fy agree")
    if not declared and not (0 <= cx <= width - 1 and 0 <= cy <= height - 1):
        raise MechSearchError(
            f"{said}; expected cx and cy in the image: is this the camera of a larger one? If the "
            "image is a part of it, tell its own width and height there too"
        )


def _name_distortion(found: Mapping[Any, Any], where: str) -> None:
    for name in (name for name in _DISTORTION if name in found):
        if isinstance(value := found[name], Mapping) and "data" not in value:
            _name_distortion(value, where)
            continue
        # A word or nothing is a model's name, without numbers.
        if value is None or isinstance(value, str):
            continue
        values = _array(value, name).ravel()
        if (values != 0).any():
            warnings.warn(
                f"{where} has a distortion, {name} {values.tolist()}, which is not undone: places "
                "are those of a rectified image",
                stacklevel=2,
            )
