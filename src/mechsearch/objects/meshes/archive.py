"""Object models as files: plain arrays in one .npz, with a checksum over all of them."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mechsearch.files import read_arrays, write_whole
from mechsearch.objects.model import ObjectModel
from mechsearch.types import Array, MechSearchError


def digest(*arrays: Array) -> str:
    """Return the SHA-256 of arrays, their shapes and types, the same on every machine."""
    sha = hashlib.sha256()
    for array in arrays:
        little = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
        sha.update(f"{little.dtype.str}{little.shape}".encode())
        sha.update(little.tobytes())
    return sha.hexdigest()


def model_to_npz(path: Path, model: ObjectModel, remark: str = "") -> None:
    """Write a model, whole or not at all.

    Args:
        path: File to write, ending in .npz.
        model: What to keep.
        remark: Free text kept beside it, such as why the object cannot lie in a heap.
    """
    text = {
        "name": model.name,
        "category": model.category,
        "content_hash": model.content_hash,
        "remark": remark,
    }
    arrays: dict[str, Array] = {
        "text": np.frombuffer(json.dumps(text, sort_keys=True).encode(), np.uint8),
        "vertices": model.vertices,
        "faces": model.faces,
        "texels": model.texels,
        "points": np.concatenate(model.parts),
        "part_sizes": np.array([len(part) for part in model.parts], np.int64),
        "scalars": np.array([model.mass, model.friction, model.hull_error], np.float64),
        "inertia": model.inertia,
    }
    arrays["checksum"] = np.frombuffer(_checksum(arrays).encode(), np.uint8)
    write_whole(path, lambda partial: np.savez_compressed(partial, allow_pickle=False, **arrays))


def model_from_npz(path: Path) -> tuple[ObjectModel, str]:
    """Read a model and its remark.

    Raises:
        MechSearchError: If the file is missing, damaged or not such a file.
    """
    try:
        arrays = read_arrays(path, "object model")
        checksum = bytes(arrays.pop("checksum")).decode()
        sound = checksum == _checksum(arrays)
        model, remark = _model(arrays)
    except (ValueError, KeyError, TypeError) as error:
        raise MechSearchError(f"the object model at {path} is damaged: {error}") from None
    if not sound:
        raise MechSearchError(f"the object model at {path} is damaged: its checksum differs")
    return model, remark


def _checksum(arrays: Mapping[str, Array]) -> str:
    return digest(*(arrays[key] for key in sorted(arrays)))


def _model(arrays: Mapping[str, Any]) -> tuple[ObjectModel, str]:
    text = json.loads(bytes(arrays["text"]))
    mass, friction, hull_error = (float(value) for value in arrays["scalars"])
    parts = np.split(arrays["points"], np.cumsum(arrays["part_sizes"])[:-1])
    model = ObjectModel(
        name=text["name"],
        category=text["category"],
        vertices=arrays["vertices"],
        faces=arrays["faces"],
        texels=arrays["texels"],
        parts=tuple(parts),
        mass=mass,
        inertia=arrays["inertia"],
        friction=friction,
        hull_error=hull_error,
        content_hash=text["content_hash"],
    )
    return model, text["remark"]
