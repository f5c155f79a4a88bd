"""Mesh files: which files belong to one, and the coloured pieces inside."""

import re
from pathlib import Path

import numpy as np
import trimesh

from mechsearch.types import MechSearchError

SUFFIXES = (".obj", ".stl", ".glb")


def source_files(path: Path) -> list[Path]:
    """Return the mesh file and, for OBJ, the material and texture files it names that exist."""
    files = [path]
    if path.suffix.lower() == ".obj":
        for name in _named(path, rb"^mtllib[ \t]+(.+?)\s*$"):
            material = path.parent / name
            if material.is_file():
                files.append(material)
                textures = _named(material, rb"^\s*map_\w+[ \t]+(?:.*[ \t])?(\S+)\s*$")
                files += [path.parent / texture for texture in textures]
    return [file for file in dict.fromkeys(files) if file.is_file()]


def _named(path: Path, pattern: bytes) -> list[str]:
    return [
        match.decode("utf-8", "replace")
        for match in re.findall(pattern, path.read_bytes(), re.MULTILINE)
    ]


def read_pieces(path: Path) -> list[trimesh.Trimesh]:
    """Return the meshes of a file in one frame [m], with their colours.

    Raises:
        MechSearchError: If the file is missing, not a mesh, empty or has numbers that are not
            finite.
    """
    if not path.is_file():
        raise MechSearchError(f"no mesh at {path}")
    try:
        scene = trimesh.load_scene(path, process=False)
        pieces = [piece for piece in scene.dump() if isinstance(piece, trimesh.Trimesh)]
    except Exception as error:  # noqa: BLE001  (parsers of foreign formats raise anything)
        raise MechSearchError(
            f"cannot read the mesh {path}: {type(error).__name__}: {error}"
        ) from None
    pieces = [piece for piece in pieces if len(piece.faces)]
    if not pieces:
        raise MechSearchError(f"the mesh {path} is empty; expected triangles")
    if not all(np.isfinite(piece.vertices).all() for piece in pieces):
        raise MechSearchError(f"the mesh {path} has vertices that are not finite")
    return pieces


def merge_pieces(pieces: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    """Return one plain mesh of all pieces, with equal vertices merged."""
    offsets = np.cumsum([0, *(len(piece.vertices) for piece in pieces)])
    faces = [piece.faces + offset for piece, offset in zip(pieces, offsets, strict=False)]
    vertices = np.concatenate([np.asarray(piece.vertices, np.float64) for piece in pieces])
    mesh = trimesh.Trimesh(vertices, np.concatenate(faces), process=True)
    mesh.update_faces(mesh.nondegenerate_faces() & mesh.unique_faces())
    mesh.remove_unreferenced_vertices()
    return mesh
