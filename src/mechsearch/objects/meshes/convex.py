"""Convex parts of a mesh: one hull where that is close enough, else a decomposition, once.

A decomposition takes minutes, and a search that is cut off by a clock or rounded otherwise finds
other parts. `known_parts.npz` holds those of the official YCB scans (Calli et al., 2015, CC BY
4.0), the same on every machine; those of any other mesh are kept in the user's cache folder.
"""

import hashlib
import json
import os
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import QhullError

from mechsearch.files import cache_folder, read_arrays, write_whole
from mechsearch.objects.meshes.hull import (
    HULL_VERTICES,
    hull_error,
    reduced_hull,
    shell_distances,
)
from mechsearch.objects.meshes.reading import READING
from mechsearch.types import Floats, MechSearchError

SINGLE_HULL_ERROR = 0.005
SINGLE_HULL_USUAL_ERROR = 0.003
"""One hull stands for an object when its error is nowhere above the first number [m], or on 95 % of
its surface below the second: the dimple of an apple does not matter, the hollow of a cup does."""

MOST_PARTS = 8
THRESHOLD = 0.08
"""CoACD's concavity bound, relative to the mesh's size."""

TIME_LIMIT = 600.0
"""Longest decomposition [s]; the slowest YCB object takes about one minute of one processor."""

KNOWN = Path(__file__).with_name("known_parts.npz")
_SCRIPT = Path(__file__).with_name("coacd_process.py")


@dataclass(frozen=True)
class ConvexParts:
    """Convex parts of one mesh.

    Attributes:
        parts: Each the vertices (P, 3) [m] of one hull.
        error: Largest distance between mesh and parts [m].
        remark: Why the decomposition failed and one hull was kept; empty if all went well.
    """

    parts: tuple[Floats, ...]
    error: float
    remark: str


def single_hull(mesh: trimesh.Trimesh) -> ConvexParts:
    """Return the one hull of a mesh.

    Raises:
        MechSearchError: If the mesh is flat.
    """
    try:
        part = reduced_hull(np.asarray(mesh.vertices))
    except (QhullError, ValueError):
        raise MechSearchError("the mesh is flat; expected a solid object") from None
    return ConvexParts((part,), hull_error(mesh, [part]), "")


def convex_parts(
    mesh: trimesh.Trimesh, simple: trimesh.Trimesh, time_limit: float = TIME_LIMIT
) -> ConvexParts:
    """Return one hull where it is close enough, else at most 8 parts by CoACD.

    Args:
        mesh: Any triangle mesh [m]; it need not be closed.
        simple: The same with fewer faces, which is what is decomposed.
        time_limit: Longest time for the decomposition [s]; then one hull is kept.

    Raises:
        MechSearchError: If the mesh is flat.
    """
    whole = single_hull(mesh)
    usual = float(np.percentile(shell_distances(mesh, whole.parts), 95))
    if whole.error <= SINGLE_HULL_ERROR or usual <= SINGLE_HULL_USUAL_ERROR:
        return whole
    try:
        parts = _decompose(simple, time_limit)
    except subprocess.TimeoutExpired:
        return replace(whole, remark=f"no decomposition in {time_limit:g} s")
    except subprocess.CalledProcessError as error:
        return replace(whole, remark=f"decomposition failed ({error.returncode})")
    split = ConvexParts(parts, hull_error(mesh, parts), "")
    return split if parts and split.error < whole.error else whole


def _decompose(mesh: trimesh.Trimesh, time_limit: float) -> tuple[Floats, ...]:
    """Run CoACD in a process with a time limit; one thread, so that results repeat."""
    with tempfile.TemporaryDirectory() as folder:
        source, result = Path(folder, "mesh.npz"), Path(folder, "parts.npz")
        np.savez(
            source,
            vertices=mesh.vertices,
            faces=mesh.faces,
            threshold=THRESHOLD,
            most=MOST_PARTS,
            allow_pickle=False,
        )
        subprocess.run(
            [sys.executable, "-P", str(_SCRIPT), str(source), str(result)],
            timeout=time_limit,
            check=True,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
        with np.load(result, allow_pickle=False) as file:
            clouds = np.split(file["points"], np.cumsum(file["sizes"])[:-1])
    parts = []
    for cloud in clouds:
        try:
            parts.append(reduced_hull(cloud))
        except (QhullError, ValueError):
            continue  # A sliver without volume adds nothing to physics.
    return tuple(parts)


def settings() -> list[float]:
    """Return the numbers that decide the convex parts of a mesh."""
    return [HULL_VERTICES, SINGLE_HULL_ERROR, SINGLE_HULL_USUAL_ERROR, MOST_PARTS, THRESHOLD]


def parts_key(mesh: Path) -> str:
    """Return the digest of a mesh file and of all settings that decide its convex parts."""
    return hashlib.sha256(json.dumps(settings()).encode() + mesh.read_bytes()).hexdigest()


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
    kept = cache_folder() / "parts" / f"{key}-{READING}.npz"
    found = known_parts().get(key)
    if found is None and kept.exists():
        try:
            found = read_table(kept).get(key)
        except MechSearchError as error:
            warnings.warn(f"{error}; the mesh is decomposed again", stacklevel=2)
    if found is None:
        found = convex_parts(mesh, simple)
        if not found.remark:
            write_table(kept, {key: found})
    return found


@cache
def known_parts() -> Mapping[str, ConvexParts]:
    """Return the convex parts of the official YCB scans, by `parts_key`."""
    return read_table(KNOWN)


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


def write_table(path: Path, found: Mapping[str, ConvexParts]) -> None:
    """Write a table of convex parts, by `parts_key`."""
    parts = [part for one in found.values() for part in one.parts]
    arrays = {
        "keys": np.array(list(found)),
        "counts": np.array([len(one.parts) for one in found.values()]),
        "errors": np.array([one.error for one in found.values()]),
        "sizes": np.array([len(part) for part in parts]),
        "points": np.concatenate(parts),
    }
    write_whole(path, lambda partial: np.savez_compressed(partial, allow_pickle=False, **arrays))
