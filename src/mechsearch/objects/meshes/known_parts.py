"""Convex parts found before, by the mesh file and the settings of the decomposition alone.

A decomposition takes minutes, and a search that is cut off by a clock or rounded otherwise finds
other parts. `known_parts.npz` holds those of the official YCB scans (Calli et al., 2015, CC BY
4.0), the same on every machine; those of any other mesh are kept in the user's cache folder.
"""

import hashlib
import json
import warnings
from collections.abc import Mapping
from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import DTypeLike

from mechsearch.files import cache_folder, read_arrays, write_whole
from mechsearch.objects.meshes import convex, hull
from mechsearch.objects.meshes.convex import ConvexParts
from mechsearch.types import MechSearchError

FILE = "known_parts.npz"


def parts_key(mesh: Path) -> str:
    """Return the digest of a mesh file and of all settings that decide its convex parts."""
    settings = [
        hull.HULL_VERTICES,
        convex.SINGLE_HULL_ERROR,
        convex.SINGLE_HULL_USUAL_ERROR,
        convex.MOST_PARTS,
        convex.THRESHOLD,
    ]
    digest = hashlib.sha256(json.dumps(settings).encode())
    digest.update(mesh.read_bytes())
    return digest.hexdigest()


def parts_of(file: Path, mesh: trimesh.Trimesh, simple: trimesh.Trimesh) -> ConvexParts:
    """Return the convex parts of a mesh file's mesh, in its own frame; found but once.

    Parts that a decomposition failed to find are not kept.

    Args:
        file: The mesh file.
        mesh: What is in it.
        simple: The same with fewer faces; see `convex_parts`.

    Raises:
        MechSearchError: If the mesh is flat.
    """
    key = parts_key(file)
    kept = cache_folder() / "parts" / f"{key}.npz"
    found = known_parts().get(key) or (_read(kept).get(key) if kept.exists() else None)
    if found is None:
        found = convex.convex_parts(mesh, simple)
        if not found.remark:
            write_table(kept, {key: found}, np.float64)
    return found


@cache
def known_parts() -> Mapping[str, ConvexParts]:
    """Return the convex parts of the official YCB scans, by `parts_key`."""
    with resources.as_file(resources.files("mechsearch.objects.meshes") / FILE) as path:
        return read_table(path)


def _read(kept: Path) -> Mapping[str, ConvexParts]:
    """Return a kept table; a damaged one is named, and empty."""
    try:
        return read_table(kept)
    except MechSearchError as error:
        warnings.warn(f"{error}; the mesh is decomposed again", stacklevel=2)
        return {}


def read_table(path: Path) -> Mapping[str, ConvexParts]:
    """Return a table of convex parts, by `parts_key`.

    Raises:
        MechSearchError: If the file is missing, damaged or no such table.
    """
    arrays = read_arrays(path, "table of convex parts")
    try:
        clouds = np.split(arrays["points"].astype(np.float64), np.cumsum(arrays["sizes"])[:-1])
        ends = np.cumsum(arrays["counts"])
        return {
            str(key): ConvexParts(tuple(clouds[end - count : end]), float(error), "")
            for key, end, count, error in zip(
                arrays["keys"], ends, arrays["counts"], arrays["errors"], strict=True
            )
        }
    except (KeyError, ValueError, TypeError) as error:
        raise MechSearchError(f"{path} is damaged or no table of convex parts: {error}") from None


def write_table(
    path: Path, found: Mapping[str, ConvexParts], precision: DTypeLike = np.float32
) -> None:
    """Write a table of convex parts, by `parts_key`, with points of some precision."""
    parts = [part for one in found.values() for part in one.parts]
    arrays = {
        "keys": np.array(list(found)),
        "counts": np.array([len(one.parts) for one in found.values()]),
        "errors": np.array([one.error for one in found.values()]),
        "sizes": np.array([len(part) for part in parts]),
        "points": np.concatenate(parts).astype(precision),
    }
    write_whole(path, lambda partial: np.savez_compressed(partial, allow_pickle=False, **arrays))
