"""Convex hulls with few vertices, their mass, and how far they are from a mesh."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, cKDTree

from mechsearch.types import Floats

HULL_VERTICES = 32
"""Most vertices of a convex part; physics slows down with more."""

_concatenate: Callable[..., Any] = trimesh.util.concatenate
_closest_point: Callable[..., Floats] = trimesh.triangles.closest_point
_SAMPLES = 4000
_CLOUD = 40_000
_FEW_FACES = 64


def reduced_hull(points: Floats, limit: int = HULL_VERTICES) -> Floats:
    """Return at most `limit` vertices (P, 3) whose hull is close to that of points (N, 3).

    Vertices are added where the hull so far misses most. Where some had to be left out, the
    result is then grown about its centroid to the volume of the full hull, so that it lies half
    outside and half inside it.

    Raises:
        scipy.spatial.QhullError: If the points lie in a plane.
    """
    full = ConvexHull(points)
    corners: Floats = full.points[np.sort(full.vertices)]
    if len(corners) <= limit:
        return corners
    chosen = _extreme_tetrahedron(corners)
    while len(chosen) < limit:
        planes = ConvexHull(corners[chosen]).equations
        outside = (corners @ planes[:, :3].T + planes[:, 3]).max(axis=1)
        chosen.append(int(outside.argmax()))
    reduced = corners[np.sort(chosen)]
    hull = as_mesh(reduced)
    growth = (full.volume / hull.volume) ** (1 / 3)
    return np.asarray(hull.center_mass + (reduced - hull.center_mass) * growth)


def _extreme_tetrahedron(corners: Floats) -> list[int]:
    """Return four corners that span a volume: each the farthest from those before."""
    first = int(corners[:, 0].argmin())
    chosen = [first]
    offsets = corners - corners[first]
    basis = np.zeros((0, 3))
    for _ in range(3):
        residual = offsets - offsets @ basis.T @ basis
        lengths = np.linalg.norm(residual, axis=1)
        chosen.append(int(lengths.argmax()))
        basis = np.vstack([basis, residual[chosen[-1]] / lengths.max()])
    return chosen


def as_mesh(part: Floats) -> trimesh.Trimesh:
    """Return the hull of one convex part (P, 3) as an outward-facing mesh."""
    hull: trimesh.Trimesh = trimesh.convex.convex_hull(part)
    return hull


@dataclass(frozen=True)
class MassProperties:
    """Uniform density, scaled to a mass.

    Attributes:
        centre: Centre of mass (3,) [m].
        inertia: About the centre of mass (3, 3) [kg m^2].
    """

    centre: Floats
    inertia: Floats


def mass_properties(meshes: Sequence[trimesh.Trimesh], mass: float) -> MassProperties:
    """Return the mass properties of closed meshes together; overlaps count twice."""
    volumes = np.array([mesh.volume for mesh in meshes])
    centres = np.array([mesh.center_mass for mesh in meshes])
    volume = volumes.sum()
    centre = volumes @ centres / volume
    inertia = np.zeros((3, 3))
    for mesh, own, offset in zip(meshes, volumes, centres - centre, strict=True):
        inertia += mesh.moment_inertia / mesh.density
        inertia += own * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    inertia = (inertia + inertia.T) / 2 * (mass / volume)
    return MassProperties(centre, inertia)


def hull_error(mesh: trimesh.Trimesh, parts: Sequence[Floats]) -> float:
    """Return the largest sampled distance between a mesh and its convex parts [m].

    The greater of two maxima: from the outer surface of the union of the parts to the mesh, and
    from the mesh to the nearest part (zero inside one), so it sees both filled hollows and
    uncovered pieces.
    """
    rng = np.random.default_rng(0)
    skin, _, _ = sample_surface(mesh, _SAMPLES, rng)
    skin = np.concatenate([skin, mesh.vertices[:: max(1, len(mesh.vertices) // _SAMPLES)]])
    skin = skin[~_inside(skin, [ConvexHull(part) for part in parts], 0.0)]
    union = _union(parts)
    uncovered = _distances(skin, union, rng)
    return float(max(uncovered.max(initial=0.0), shell_distances(mesh, parts).max(initial=0.0)))


def shell_distances(mesh: trimesh.Trimesh, parts: Sequence[Floats]) -> Floats:
    """Return distances (N,) [m] to a mesh, from points on the outer surface of its parts."""
    rng = np.random.default_rng(0)
    union = _union(parts)
    shell, _, _ = sample_surface(union, _SAMPLES, rng)
    shell = shell[~_inside(shell, [ConvexHull(part) for part in parts], -1e-5)]
    return _distances(shell, mesh, rng)


def _union(parts: Sequence[Floats]) -> trimesh.Trimesh:
    union: trimesh.Trimesh = _concatenate([as_mesh(part) for part in parts])
    return union


def sample_surface(
    mesh: trimesh.Trimesh, count: int, rng: np.random.Generator
) -> tuple[Floats, NDArray[np.int64], Floats]:
    """Return uniform points (N, 3), their faces (N,) and barycentric coordinates (N, 3)."""
    share = np.cumsum(mesh.area_faces)
    face = np.searchsorted(share, rng.random(count) * share[-1]).clip(max=len(share) - 1)
    u, v = rng.random((2, count))
    root = np.sqrt(u)
    weights = np.column_stack([1 - root, root * (1 - v), root * v])
    points = np.einsum("nk,nkd->nd", weights, mesh.triangles[face])
    return points, face, weights


def _inside(points: Floats, hulls: Sequence[ConvexHull], margin: float) -> NDArray[np.bool_]:
    """Tell which points lie inside some hull, its faces moved outwards by `margin` [m]."""
    inside = np.zeros(len(points), bool)
    for hull in hulls:
        planes = hull.equations
        inside |= (points @ planes[:, :3].T + planes[:, 3]).max(axis=1) < margin
    return inside


def _distances(points: Floats, mesh: trimesh.Trimesh, rng: np.random.Generator) -> Floats:
    """Return distances (N,) to a surface.

    Exact for few triangles; else to the triangles of the nearest samples, which is up to half a
    sample spacing too long where another triangle is nearer.
    """
    if not len(points):
        return np.zeros(0)
    if len(mesh.faces) <= _FEW_FACES:
        near = np.broadcast_to(np.arange(len(mesh.faces)), (len(points), len(mesh.faces)))
    else:
        cloud, owner, _ = sample_surface(mesh, _CLOUD, rng)
        near = owner[cKDTree(cloud).query(points, k=4)[1]]
    repeated = np.repeat(points, near.shape[1], axis=0)
    closest = _closest_point(mesh.triangles[near.ravel()], repeated)
    lengths = np.linalg.norm(closest - repeated, axis=1)
    return np.asarray(lengths.reshape(near.shape).min(axis=1))
