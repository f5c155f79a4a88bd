"""Convex parts of a mesh: one hull where that is close enough, else a decomposition."""

import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import QhullError

from mechsearch.objects.meshes.hull import hull_error, reduced_hull, shell_distances
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
        return ConvexParts(whole.parts, whole.error, f"no decomposition in {time_limit:g} s")
    except subprocess.CalledProcessError as error:
        return ConvexParts(whole.parts, whole.error, f"decomposition failed ({error.returncode})")
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
