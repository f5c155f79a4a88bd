"""Object models as files: plain arrays in one .npz, with a checksum over all of them."""

import hashlib
import json
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mechsearch.objects.model import ObjectModel
from mechsearch.runs import write_whole
from mechsearch.types import Array, Floats, MechSearchError


def content_hash(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    texels: NDArray[np.uint8],
    parts: Sequence[Floats],
    mass: float,
    inertia: Floats,
    friction: float,
) -> str:
    """Return the SHA-256 of all that physics and rendering read, as 64 hexadecimal digits.

    Args:
        vertices: Visual mesh (V, 3) [m].
        faces: Triangles (F, 3).
        texels: Colours (F, T, 3).
        parts: Convex parts, each (P, 3) [m].
        mass: [kg].
        inertia: About the centre of mass (3, 3) [kg m^2].
        friction: Sliding coefficient.
    """
    scalars = np.array([mass, friction], np.float64)
    return digest(
        np.asarray(vertices, np.float64),
        np.asarray(faces, np.int32),
        np.asarray(texels, np.uint8),
        *(np.asarray(part, np.float64) for part in parts),
        np.asarray(inertia, np.float64),
        scalars,
    )


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
    write_whole(path, lambda partial: np.savez_compressed(partial, **arrays))


def model_from_npz(path: Path) -> tuple[ObjectModel, str]:
    """Read a model and its remark.

    Raises:
        MechSearchError: If the file is missing, damaged or not such a file.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {key: file[key] for key in file.files}
        checksum = bytes(arrays.pop("checksum")).decode()
        sound = checksum == _checksum(arrays)
        model, remark = _model(arrays)
    except FileNotFoundError:
        raise MechSearchError(f"no object model at {path}") from None
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, *_ZIP_ERRORS) as error:
        raise MechSearchError(f"the object model at {path} is damaged: {error}") from None
    if not sound:
        raise MechSearchError(f"the object model at {path} is damaged: its checksum differs")
    return model, remark


# What zipfile raises on damaged headers and streams, beside BadZipFile.
_ZIP_ERRORS = (NotImplementedError, RuntimeError, zlib.error)


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
