"""Colours of a simplified mesh, taken from the surface it came from."""

import colorsys
import hashlib

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mechsearch.objects.hull import sample_surface
from mechsearch.types import Floats

Colours = NDArray[np.uint8]


def barycentric_grid(rows: int) -> Floats:
    """Return barycentric coordinates (T, 3), T = rows (rows + 1) / 2, of a regular grid.

    Row i of the grid has i + 1 samples; the first is corner 0, the last row joins corners 1 and
    2. One row is the centroid.
    """
    if rows == 1:
        return np.full((1, 3), 1 / 3)
    steps = rows - 1
    grid = [(steps - i, i - j, j) for i in range(rows) for j in range(i + 1)]
    return np.array(grid, np.float64) / steps


def bake_texels(
    vertices: Floats,
    faces: NDArray[np.int32],
    pieces: list[trimesh.Trimesh],
    name: str,
    rows: int,
    samples: int,
) -> Colours:
    """Return texels (F, T, 3): at each grid point, the colour of the nearest original point.

    Args:
        vertices: Simplified mesh (V, 3) [m], in the frame of `pieces`.
        faces: Its triangles (F, 3).
        pieces: Original meshes with textures, vertex or face colours, or none.
        name: Decides the colour of pieces without one.
        rows: Rows of the barycentric grid.
        samples: Points drawn on the original surface.
    """
    cloud, colours = _coloured_cloud(pieces, name, samples)
    if (colours == colours[0]).all():
        return np.broadcast_to(colours[0], (len(faces), 1, 3)).copy()
    points = np.einsum("tk,fkd->ftd", barycentric_grid(rows), vertices[faces])
    _, nearest = cKDTree(cloud).query(points.reshape(-1, 3))
    return colours[nearest].reshape(*points.shape)


def colour_of_name(name: str) -> Colours:
    """Return a bright colour (3,) that depends on the name alone."""
    seed = hashlib.sha256(name.encode()).digest()
    rgb = colorsys.hsv_to_rgb(seed[0] / 255, 0.45 + seed[1] / 640, 0.65 + seed[2] / 850)
    return np.round(np.array(rgb) * 255).astype(np.uint8)


def _coloured_cloud(
    pieces: list[trimesh.Trimesh], name: str, samples: int
) -> tuple[Floats, Colours]:
    rng = np.random.default_rng(0)
    area = sum(piece.area for piece in pieces)
    clouds, colours = [], []
    for piece in pieces:
        count = max(1, round(samples * piece.area / area))
        points, face, weights = sample_surface(piece, count, rng)
        clouds.append(points)
        colours.append(_colours(piece, face, weights, name))
    return np.concatenate(clouds), np.concatenate(colours)


def _colours(
    piece: trimesh.Trimesh, face: NDArray[np.int64], weights: Floats, name: str
) -> Colours:
    """Return the colours (N, 3) of points on one piece."""
    visual = piece.visual
    if visual.kind == "texture":
        return _texture_colours(piece, face, weights, name)
    if visual.kind == "face":
        return np.asarray(visual.face_colors[face, :3], np.uint8)
    if visual.kind == "vertex":
        corners = visual.vertex_colors[piece.faces[face], :3].astype(np.float64)
        return np.round(np.einsum("nk,nkc->nc", weights, corners)).astype(np.uint8)
    return np.broadcast_to(colour_of_name(name), (len(face), 3))


def _texture_colours(
    piece: trimesh.Trimesh, face: NDArray[np.int64], weights: Floats, name: str
) -> Colours:
    material = piece.visual.material
    if hasattr(material, "to_simple"):
        material = material.to_simple()
    image, uv = getattr(material, "image", None), piece.visual.uv
    if image is None or uv is None or len(uv) != len(piece.vertices):
        main = getattr(material, "diffuse", None)
        colour = colour_of_name(name) if main is None else np.asarray(main, np.uint8)[:3]
        return np.broadcast_to(colour, (len(face), 3))
    pixels = np.asarray(image.convert("RGB"))
    height, width = pixels.shape[:2]
    u, v = np.einsum("nk,nkc->cn", weights, np.asarray(uv)[piece.faces[face]])
    column = np.floor(u * width).astype(np.int64) % width
    row = np.floor((1 - v) * height).astype(np.int64) % height
    return np.asarray(pixels[row, column])
