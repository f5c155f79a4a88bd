"""Colours of a simplified mesh, taken from the surface it came from."""

import colorsys
import hashlib
from collections.abc import Callable

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from trimesh.visual import ColorVisuals, TextureVisuals
from trimesh.visual.material import PBRMaterial, SimpleMaterial

from mechsearch.objects.meshes.hull import sample_surface
from mechsearch.objects.model import texel_weights
from mechsearch.types import Floats

Colours = NDArray[np.uint8]

_to_simple: Callable[[PBRMaterial], SimpleMaterial] = PBRMaterial.to_simple


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
    points = np.einsum("tk,fkd->ftd", texel_weights(rows, 1 / 3), vertices[faces])
    _, nearest = cKDTree(cloud).query(points.reshape(-1, 3))
    baked: Colours = colours[nearest].reshape(*points.shape)
    return baked


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
    if isinstance(visual, TextureVisuals):
        return _texture_colours(piece, visual, face, weights, name)
    if isinstance(visual, ColorVisuals) and visual.kind == "face":
        flat: Colours = np.asarray(visual.face_colors, np.uint8)[face, :3]
        return flat
    if isinstance(visual, ColorVisuals) and visual.kind == "vertex":
        corners = np.asarray(visual.vertex_colors, np.float64)[piece.faces[face], :3]
        mixed: Floats = np.einsum("nk,nkc->nc", weights, corners)
        return mixed.round().astype(np.uint8)
    return np.broadcast_to(colour_of_name(name), (len(face), 3))


def _texture_colours(
    piece: trimesh.Trimesh,
    visual: TextureVisuals,
    face: NDArray[np.int64],
    weights: Floats,
    name: str,
) -> Colours:
    material = visual.material
    if isinstance(material, PBRMaterial):
        material = _to_simple(material)
    image, uv = getattr(material, "image", None), visual.uv
    if image is None or uv is None or len(uv) != len(piece.vertices):
        main = getattr(material, "diffuse", None)
        colour = colour_of_name(name) if main is None else np.asarray(main, np.uint8)[:3]
        return np.broadcast_to(colour, (len(face), 3))
    pixels: Colours = np.asarray(image.convert("RGB"), np.uint8)
    height, width = pixels.shape[:2]
    u, v = np.einsum("nk,nkc->cn", weights, np.asarray(uv)[piece.faces[face]])
    column = np.floor(u * width).astype(np.int64) % width
    row = np.floor((1 - v) * height).astype(np.int64) % height
    picked: Colours = pixels[row, column]
    return picked
