"""Convex parts of the YCB objects, decomposed once, so that they are the same on every machine.

A decomposition takes minutes, and a search that is cut off by a clock or rounded otherwise finds
other parts. `known_parts.npz` holds those of the official scans (Calli et al., 2015, CC BY 4.0),
by the digest of the mesh file and of the settings; any other mesh is decomposed where it is used.
"""

import hashlib
import json
from collections.abc import Mapping
from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np

from mechsearch.files import write_whole
from mechsearch.objects.meshes import convex, hull
from mechsearch.objects.meshes.convex import ConvexParts
from mechsearch.types import Array

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


def known_parts(mesh: Path) -> ConvexParts | None:
    """Return the convex parts of a mesh file's mesh, in its own frame, if they are known."""
    return _table().get(parts_key(mesh))


@cache
def _table() -> Mapping[str, ConvexParts]:
    with (
        resources.as_file(resources.files("mechsearch.objects.meshes") / FILE) as path,
        np.load(path, allow_pickle=False) as file,
    ):
        arrays: dict[str, Array] = dict(file.items())
    clouds = np.split(arrays["points"].astype(np.float64), np.cumsum(arrays["sizes"])[:-1])
    ends = np.cumsum(arrays["counts"])
    return {
        str(key): ConvexParts(tuple(clouds[end - count : end]), float(error), "")
        for key, end, count, error in zip(
            arrays["keys"], ends, arrays["counts"], arrays["errors"], strict=True
        )
    }


def write_table(path: Path, found: Mapping[str, ConvexParts]) -> None:
    """Write a table of convex parts, by `parts_key`; points are kept in single precision."""
    parts = [part for one in found.values() for part in one.parts]

    def write(partial: Path) -> None:
        with partial.open("wb") as file:
            np.savez_compressed(
                file,
                allow_pickle=False,
                keys=np.array(list(found)),
                counts=np.array([len(one.parts) for one in found.values()]),
                errors=np.array([one.error for one in found.values()]),
                sizes=np.array([len(part) for part in parts]),
                points=np.concatenate(parts).astype(np.float32),
            )

    write_whole(path, write)
