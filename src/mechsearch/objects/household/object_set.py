"""The embedded object set: everyday things modelled in code, ready without a download.

Each is put together from convex solids: mass properties, hull error and one mesh. Categories,
dimensions and masses follow the table of the YCB set (Calli et al., "Benchmarking in Manipulation
Research", IEEE Robotics & Automation Magazine, 2015); shapes and colours are our own.
"""

from collections.abc import Iterable
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from mechsearch.objects.household.items import items
from mechsearch.objects.household.primitives import Solids
from mechsearch.objects.model import FRICTION, TEXEL_ROWS, ObjectModel, ObjectSet
from mechsearch.types import Floats

_DECIMALS = 6  # A micrometre, so that the last bits of a sine change no digest.
_INERTIA_DECIMALS = 12


@cache
def household() -> ObjectSet:
    """Return the default set: 56 objects of the household, none left out of heaps."""
    models = {
        name: union_of(name, category, grams / 1000, solids)
        for name, category, grams, solids in items()
    }
    return ObjectSet("household", models, {})


def union_of(name: str, category: str, mass: float, solids: Solids) -> ObjectModel:
    """Return the object that is the union of solids.

    The mass is spread evenly over the convex parts; where two of them overlap it counts twice.
    The hull error bounds the distance between mesh and parts from above: it is the largest
    distance between a solid's own surface and its own convex part.

    Args:
        name: Of the object.
        category: Such as "can".
        mass: [kg].
        solids: In any common frame.
    """
    volumes, centres, moments = (
        np.array(values)
        for values in zip(*(moments_of(solid.hull) for solid in solids), strict=True)
    )
    density = mass / volumes.sum()
    centre = volumes @ centres / volumes.sum()
    second = density * moments.sum(axis=0) - mass * np.outer(centre, centre)
    inertia = np.round(np.trace(second) * np.eye(3) - second, _INERTIA_DECIMALS)
    starts = np.cumsum([0, *(len(solid.vertices) for solid in solids[:-1])])
    faces = [solid.faces + start for solid, start in zip(solids, starts, strict=True)]
    return ObjectModel(
        name,
        category,
        _rounded(np.concatenate([solid.vertices for solid in solids]) - centre),
        np.concatenate(faces, dtype=np.int32),
        _shared_grid([solid.texels for solid in solids]),
        tuple(_rounded(solid.hull - centre) for solid in solids),
        mass,
        inertia,
        FRICTION,
        max(hausdorff(solid.vertices, solid.hull) for solid in solids),
    )


def moments_of(corners: Floats) -> tuple[float, Floats, Floats]:
    """Return volume [m^3], centroid (3,) [m] and integral of x x^T (3, 3) [m^5] of a hull."""
    inside = corners.mean(axis=0)
    triangles = (corners - inside)[ConvexHull(corners).simplices]
    volumes = np.abs(np.linalg.det(triangles)) / 6
    sums = triangles.sum(axis=1)
    volume = float(volumes.sum())
    offset = volumes @ sums / (4 * volume)
    squares = np.einsum("fci,fcj->fij", triangles, triangles) + np.einsum("fi,fj->fij", sums, sums)
    about_inside = np.einsum("f,fij->ij", volumes / 20, squares)
    centroid = inside + offset
    shift = np.outer(centroid, centroid) - np.outer(offset, offset)
    return volume, centroid, about_inside + volume * shift


def hausdorff(first: Floats, second: Floats) -> float:
    """Return the Hausdorff distance [m] of the convex hulls of two sets of points (N, 3).

    For convex bodies it is that of their surfaces too, and a corner attains it.
    """
    return max(_farthest(first, second), _farthest(second, first))


def _farthest(points: Floats, corners: Floats) -> float:
    """Return how far the farthest of the points lies outside the hull of the corners."""
    hull = ConvexHull(corners)
    heights = points @ hull.equations[:, :3].T + hull.equations[:, 3]
    outside = points[heights.max(axis=1) > 1e-9]
    if not len(outside):
        return 0.0
    return float(triangle_distances(outside, corners[hull.simplices]).min(axis=1).max())


def triangle_distances(points: Floats, triangles: Floats) -> Floats:
    """Return the distance (N, F) [m] of each point (N, 3) to each triangle (F, 3, 3)."""
    edges = np.roll(triangles, -1, axis=1) - triangles
    normals = np.cross(edges[:, 0], edges[:, 1])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offsets = points[:, None, None] - triangles  # (N, F, 3, 3): from each corner.
    share = np.einsum("nfcd,fcd->nfc", offsets, edges) / np.einsum("fcd,fcd->fc", edges, edges)
    nearest = offsets - np.clip(share, 0, 1)[..., None] * edges
    to_edges = np.linalg.norm(nearest, axis=-1).min(axis=2)
    inward = np.cross(normals[:, None], edges)
    above = (np.einsum("nfcd,fcd->nfc", offsets, inward) >= 0).all(axis=2)
    to_plane = np.abs(np.einsum("nfd,fd->nf", offsets[:, :, 0], normals))
    return np.asarray(np.where(above, to_plane, to_edges))


def _shared_grid(texels: Iterable[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Stack texels (F, T, 3), with T = 1 when every triangle has one colour."""
    count = TEXEL_ROWS * (TEXEL_ROWS + 1) // 2
    stacked = np.concatenate([np.broadcast_to(block, (len(block), count, 3)) for block in texels])
    return stacked[:, :1].copy() if (stacked == stacked[:, :1]).all() else stacked


def _rounded(points: Floats) -> Floats:
    return np.round(points, _DECIMALS) + 0.0
