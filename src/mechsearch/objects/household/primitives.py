"""Convex solids, the bricks of the household objects: coarse for physics, finer to look at."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from mechsearch.objects.model import TEXEL_ROWS, texel_weights
from mechsearch.types import Floats, MechSearchError

Paint = Callable[[Floats, Floats], NDArray[np.uint8]]
"""Colours (N, 3) of surface points (N, 3) [m] with outward normals (N, 3)."""

TEXEL_CENTRE = 0.5
"""Where in its cell a texel is coloured: at the centre of the square, which for a cell on the
slanted edge, shared with the triangle beyond it, lies on that edge."""

MOST_CORNERS = 32
_GREY = 160


@dataclass(frozen=True)
class Solid:
    """A convex solid.

    Attributes:
        hull: Corners (P, 3) [m] of its convex part, at most 32.
        vertices: Of its surface (V, 3) [m].
        faces: Triangles of its surface (F, 3), counter-clockwise from outside.
        texels: Colours (F, T, 3) uint8, as in `ObjectModel`.
    """

    hull: Floats
    vertices: Floats
    faces: NDArray[np.int32]
    texels: NDArray[np.uint8]

    def painted(self, paint: Paint) -> "Solid":
        """Return the solid with the colours that `paint` gives its surface where it is now."""
        weights = texel_weights(TEXEL_ROWS, TEXEL_CENTRE)
        corners = self.vertices[self.faces]
        points = np.einsum("tc,fcd->ftd", weights, corners)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        colours = paint(points.reshape(-1, 3), np.repeat(normals, len(weights), axis=0))
        return replace(self, texels=colours.reshape(points.shape))

    def moved(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> "Solid":
        """Return the solid displaced by (x, y, z) [m]."""
        return self._mapped(np.eye(3), np.array([x, y, z]))

    def turned(self, axis: str, degrees: float) -> "Solid":
        """Return the solid rotated about "x", "y" or "z" through the origin."""
        rotation = Rotation.from_euler(axis, degrees, degrees=True)
        return self._mapped(rotation.as_matrix(), np.zeros(3))

    def scaled(self, x: float = 1.0, y: float = 1.0, z: float = 1.0) -> "Solid":
        """Return the solid stretched along each axis by a positive factor."""
        return self._mapped(np.diag([x, y, z]), np.zeros(3))

    def _mapped(self, matrix: Floats, offset: Floats) -> "Solid":
        return replace(
            self, hull=self.hull @ matrix.T + offset, vertices=self.vertices @ matrix.T + offset
        )


Solids = Sequence[Solid]


def skin(rings: ArrayLike, hull: ArrayLike | None = None) -> Solid:
    """Return the solid that K rings of N corners each span, closed by a fan at either end.

    Args:
        rings: Corners (K, N, 3) [m]; each ring runs the same way round.
        hull: Corners (P, 3) [m] of the convex part; those of the rings when None.

    Raises:
        MechSearchError: If the convex part has more than 32 corners.
    """
    loops = np.asarray(rings, np.float64)
    count, size, _ = loops.shape
    vertices = np.concatenate([loops.reshape(-1, 3), loops[[0, -1]].mean(axis=1)])
    here = np.arange(size)
    beside = np.roll(here, -1)
    bottom, top = count * size, count * size + 1
    last = bottom - size
    faces = [np.stack([np.full(size, bottom), beside, here], 1)]
    for below in range(0, last, size):
        above = below + size
        faces.append(np.stack([below + beside, above + beside, below + here], 1))
        faces.append(np.stack([above + here, below + here, above + beside], 1))
    faces.append(np.stack([np.full(size, top), last + here, last + beside], 1))
    part = loops.reshape(-1, 3) if hull is None else np.asarray(hull, np.float64)
    return _solid(part, vertices, np.concatenate(faces))


def box(x: float, y: float, z: float, cells: int = 4) -> Solid:
    """Return a box of size x, y, z [m], centred; each side is a grid of cells x cells squares."""
    steps = np.linspace(-0.5, 0.5, cells + 1)
    u, v = (grid.ravel() for grid in np.meshgrid(steps, steps, indexing="ij"))
    row, column = (g.ravel() for g in np.meshgrid(range(cells), range(cells), indexing="ij"))
    corner = row * (cells + 1) + column
    across, along = corner + cells + 1, corner + 1
    quads = np.concatenate(
        [np.stack([across, across + 1, corner], 1), np.stack([along, corner, across + 1], 1)]
    )
    sides = [(axis, end) for axis in range(3) for end in (-0.5, 0.5)]
    vertices = [np.roll(np.stack([np.full_like(u, end), u, v], 1), axis, 1) for axis, end in sides]
    faces = [
        (quads if end > 0 else quads[:, [0, 2, 1]]) + len(u) * number
        for number, (_, end) in enumerate(sides)
    ]
    corners = np.stack(np.meshgrid(*[(-0.5, 0.5)] * 3), -1).reshape(-1, 3)
    return _solid(corners, np.concatenate(vertices), np.concatenate(faces)).scaled(x, y, z)


def frustum(bottom: float, top: float, height: float, sides: int = 16, bands: int = 6) -> Solid:
    """Return an upright truncated cone that stands on height 0.

    Args:
        bottom: Diameter at height 0 [m], above 0.
        top: Diameter at the top [m], above 0.
        height: [m].
        sides: Of the convex part, at most 16; the surface has twice as many.
        bands: Rows of faces along the height.
    """
    level = np.linspace(0, 1, bands + 1)[:, None, None]
    low, high = (_circle(d / 2, 2 * sides) for d in (bottom, top))
    lift = np.array([0.0, 0.0, height])
    rings = low * (1 - level) + (high + lift) * level
    even = 2 / (1 + np.cos(np.pi / sides))
    hull = [_circle(bottom / 2 * even, sides), _circle(top / 2 * even, sides) + lift]
    return skin(rings, np.concatenate(hull))


def stack(profile: Sequence[tuple[float, float]], sides: int = 12) -> tuple[Solid, ...]:
    """Return a body of revolution in slices: (diameter, height) [m], from the bottom up."""
    return tuple(
        frustum(low, high, top - bottom, sides, 2).moved(z=bottom)
        for (low, bottom), (high, top) in pairwise(profile)
    )


def cylinder(diameter: float, height: float, sides: int = 16, bands: int = 6) -> Solid:
    """Return an upright cylinder that stands on height 0; see `frustum`."""
    return frustum(diameter, diameter, height, sides, bands)


def ellipsoid(x: float, y: float, z: float) -> Solid:
    """Return a centred ellipsoid with diameters x, y, z [m]: 1,280 faces over 32 corners."""
    vertices, faces = _sphere(3)
    return _solid(_round_hull(), vertices, faces).scaled(x / 2, y / 2, z / 2)


def prism(outline: ArrayLike, height: float, bands: int = 1, cells: int = 1) -> Solid:
    """Return a convex outline (N, 2) [m], raised from height 0 to `height` [m].

    Args:
        outline: Corners, either way round.
        height: [m].
        bands: Rows of faces along the height.
        cells: Faces along each side of the outline.
    """
    corners = np.pad(np.asarray(outline, np.float64), ((0, 0), (0, 1)))
    share = np.linspace(0, 1, cells, endpoint=False)[:, None]
    along = corners[:, None] * (1 - share) + np.roll(corners, -1, axis=0)[:, None] * share
    levels = np.linspace(0, height, bands + 1)[:, None, None] * [0.0, 0.0, 1.0]
    return skin(along.reshape(1, -1, 3) + levels, np.concatenate([corners, corners + levels[-1]]))


def tube(path: ArrayLike, widths: Sequence[float], heights: Sequence[float]) -> tuple[Solid, ...]:
    """Return the pieces of a bent rod along a path in the plane z = 0, with mitred joints.

    Args:
        path: Corners of the path (K, 2) [m].
        widths: Diameter in the plane at each corner [m].
        heights: Diameter along z at each corner [m].
    """
    points = np.asarray(path, np.float64)
    steps = np.diff(points, axis=0)
    steps /= np.linalg.norm(steps, axis=1, keepdims=True)
    before, after = np.vstack([steps[:1], steps]), np.vstack([steps, steps[-1:]])
    along = before + after
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    mitre = 1 / np.einsum("kd,kd->k", along, after)
    side = np.stack([-along[:, 1], along[:, 0]], 1) * (mitre * widths / 2)[:, None]

    def rings(sides: int, scale: float) -> Floats:
        circle = _circle(scale, sides)
        flat = points[:, None] + side[:, None] * circle[None, :, :1]
        up = np.asarray(heights)[:, None, None] / 2 * circle[None, :, 1:2]
        return np.concatenate([flat, up], axis=2)

    fine, coarse = rings(16, 1.0), rings(8, 2 / (1 + np.cos(np.pi / 8)))
    return tuple(skin(fine[k : k + 2], coarse[k : k + 2].reshape(-1, 3)) for k in range(len(steps)))


def shell(
    inner: Sequence[tuple[float, float]], outer: Sequence[tuple[float, float]], sectors: int
) -> tuple[Solid, ...]:
    """Return the wall of a round vessel in convex sectors, flat inside and round outside.

    Args:
        inner: (radius, height) [m] of the inside, bottom to top.
        outer: (radius, height) [m] of the outside, top to bottom; with `inner` it goes round a
            convex cross-section.
        sectors: Number of pieces.
    """
    section = np.array([*inner, *outer])
    half = np.pi / sectors
    turns = np.linspace(-half, half, 5)
    chord = np.cos(half) / np.cos(turns)
    radii = section[:, 0] * np.ones((5, 1))
    radii[:, : len(inner)] *= chord[:, None]
    heights = np.broadcast_to(section[:, 1], radii.shape)
    even = 2 / (1 + np.cos(half / 2))

    def sweep(middle: float) -> Floats:
        angles = (middle + turns)[:, None]
        return np.stack([radii * np.cos(angles), radii * np.sin(angles), heights], 2)

    pieces = []
    for sector in range(sectors):
        rings = sweep(2 * half * sector)
        coarse = rings[::2] * np.where(np.arange(len(section)) < len(inner), 1.0, even)[:, None]
        coarse[..., 2] = heights[::2]
        pieces.append(skin(rings, coarse.reshape(-1, 3)))
    return tuple(pieces)


def fitted(solids: Sequence[Solid], x: float, y: float, z: float) -> tuple[Solid, ...]:
    """Return solids stretched together to fill a box of size x, y, z [m]."""
    points = np.concatenate([solid.vertices for solid in solids])
    factors = np.array([x, y, z]) / np.ptp(points, axis=0)
    return tuple(solid.scaled(*factors) for solid in solids)


def _solid(hull: Floats, vertices: Floats, faces: NDArray[np.intp]) -> Solid:
    if len(hull) > MOST_CORNERS:
        raise MechSearchError(
            f"a convex part has {len(hull)} corners; expected at most {MOST_CORNERS}"
        )
    corners = vertices[faces] - vertices.mean(axis=0)
    outward = float(np.einsum("fd,fd->", np.cross(corners[:, 0], corners[:, 1]), corners[:, 2])) > 0
    texels = np.full((len(faces), 1, 3), _GREY, np.uint8)
    return Solid(
        hull, vertices, (faces if outward else faces[:, [0, 2, 1]]).astype(np.int32), texels
    )


def _circle(radius: float, sides: int) -> Floats:
    angles = 2 * np.pi * np.arange(sides) / sides
    return radius * np.stack([np.cos(angles), np.sin(angles), np.zeros(sides)], 1)


@cache
def _round_hull() -> Floats:
    """Return corners (32, 3) that stand out of the unit sphere as far as their faces sink in."""
    twelve, triangles = _sphere(0)
    twenty = twelve[triangles].mean(axis=1)
    corners = np.concatenate([twelve, twenty / np.linalg.norm(twenty, axis=1, keepdims=True)])
    inner, fine = (
        float(-ConvexHull(points).equations[:, 3].max()) for points in (corners, _sphere(3)[0])
    )
    return corners * ((1 + fine) / (1 + inner))


@cache
def _sphere(level: int) -> tuple[Floats, NDArray[np.intp]]:
    """Return an icosahedron whose faces are cut in four `level` times, on the unit sphere."""
    if level == 0:
        golden = (1 + 5**0.5) / 2
        pairs = [(a, b) for a in (-1.0, 1.0) for b in (-golden, golden)]
        corners = np.array([np.roll([0, a, b], axis) for axis in range(3) for a, b in pairs])
        near = [
            (i, j, k)
            for i in range(12)
            for j in range(i)
            for k in range(j)
            if np.linalg.norm(corners[[i, j, k]] - corners[[j, k, i]], axis=1).max() < 2.1
        ]
        return corners / np.linalg.norm(corners[0]), _outward(corners, np.array(near))
    vertices, faces = _sphere(level - 1)
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, index = np.unique(edges, axis=0, return_inverse=True)
    middles = vertices[unique].sum(axis=1)
    middles /= np.linalg.norm(middles, axis=1, keepdims=True)
    (a, b, c), (ab, bc, ca) = faces.T, (index.reshape(-1, 3) + len(vertices)).T
    parts = [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]
    return np.vstack([vertices, middles]), np.concatenate([np.stack(part, 1) for part in parts])


def _outward(vertices: Floats, faces: NDArray[np.intp]) -> NDArray[np.intp]:
    flipped = np.linalg.det(vertices[faces]) < 0
    return np.where(flipped[:, None], faces[:, ::-1], faces)
