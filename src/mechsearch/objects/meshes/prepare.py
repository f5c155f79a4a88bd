"""From a mesh file and a mass to an object ready for physics and rendering."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import fast_simplification
import numpy as np
import trimesh
from numpy.typing import NDArray

from mechsearch.objects.hashing import content_hash
from mechsearch.objects.meshes.convex import ConvexParts, convex_parts, single_hull
from mechsearch.objects.meshes.hull import MassProperties, as_mesh, mass_properties
from mechsearch.objects.meshes.known_parts import known_parts
from mechsearch.objects.meshes.limits import why_wrong_mass, why_wrong_shape, why_wrong_size
from mechsearch.objects.meshes.mesh_file import joined, read_pieces
from mechsearch.objects.meshes.texels import bake_texels
from mechsearch.objects.model import ObjectModel
from mechsearch.types import Floats, MechSearchError

VERSION = 2
"""Raised with every change of the results of preparation, so that old cache files are not used."""

MOST_FACES = 1500
TEXEL_ROWS = 6
COLOUR_SAMPLES = 200_000
FRICTION = 0.5
"""Sliding friction of an object whose own is unknown; about wood on wood."""


_subdivide: Callable[..., tuple[Floats, NDArray[np.int64]]] = trimesh.remesh.subdivide


@dataclass(frozen=True)
class Source:
    """What an object is made from.

    Attributes:
        name: Unique in its set.
        category: Free text.
        mesh: An OBJ, STL or GLB file [m].
        mass: [kg].
    """

    name: str
    category: str
    mesh: Path
    mass: float


@dataclass(frozen=True)
class Prepared:
    """A prepared object.

    Attributes:
        model: The object.
        excluded: Why it cannot lie in a heap, or an empty string.
        remark: What went wrong on the way without harm; known right after preparation only.
    """

    model: ObjectModel
    excluded: str
    remark: str = ""


def prepare(source: Source) -> Prepared:
    """Prepare one object: centre, simplify, colour, split into convex parts, weigh.

    An object of a size that no heap takes is given a single hull, which is quick.

    Raises:
        MechSearchError: If the mesh cannot be read or is flat, or the mass is not positive.
    """
    if not (np.isfinite(source.mass) and source.mass > 0):
        raise MechSearchError(
            f"the mass of {source.name} is {source.mass}; expected a positive number of kilograms"
        )
    pieces = read_pieces(source.mesh)
    mesh = joined(pieces)
    try:
        whole = single_hull(mesh)
        vertices, faces = simplified(mesh)
        wrong_size = why_wrong_size(source.name, np.asarray(mesh.vertices))
        convex = (
            whole
            if wrong_size
            else known_parts(source.mesh)
            or convex_parts(mesh, trimesh.Trimesh(vertices, faces, process=False))
        )
    except (MechSearchError, ValueError, IndexError) as error:
        raise MechSearchError(f"cannot prepare {source.name} from {source.mesh}: {error}") from None
    texels = bake_texels(vertices, faces, pieces, source.name, TEXEL_ROWS, COLOUR_SAMPLES)
    body = weigh(mesh, convex, source.mass)
    excluded = (
        wrong_size
        or why_wrong_mass(source.mass, float(mesh.convex_hull.volume))
        or why_wrong_shape(convex.error, convex.remark)
    )
    model = _model(source, vertices - body.centre, faces, texels, convex, body)
    return Prepared(model, excluded, convex.remark)


def simplified(mesh: trimesh.Trimesh) -> tuple[Floats, NDArray[np.int32]]:
    """Return the vertices and at most 1,500 faces of a mesh.

    A mesh of very few faces is cut finer instead, so that its triangles can carry colours.
    """
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if len(faces) > MOST_FACES:
        vertices, faces = fast_simplification.simplify(
            np.ascontiguousarray(vertices, np.float64),
            np.ascontiguousarray(faces, np.int32),
            target_count=MOST_FACES,
        )
    while 4 * len(faces) <= MOST_FACES:
        vertices, faces = _subdivide(vertices, faces)
    return np.asarray(vertices, np.float64), np.asarray(faces, np.int32)


def weigh(mesh: trimesh.Trimesh, convex: ConvexParts, mass: float) -> MassProperties:
    """Return mass properties of the mesh where it encloses a volume, else of its parts."""
    if mesh.is_volume:
        body = mass_properties([mesh], mass)
        if _possible(body, mesh):
            return body
    return mass_properties([as_mesh(part) for part in convex.parts], mass)


def _possible(body: MassProperties, mesh: trimesh.Trimesh) -> bool:
    """Tell whether a solid can have this inertia: crossing surfaces may give ones that none has."""
    moments = np.linalg.eigvalsh(body.inertia)
    low, high = mesh.bounds
    within = bool(np.all(body.centre >= low) and np.all(body.centre <= high))
    return within and moments[0] > 0 and moments[0] + moments[1] >= moments[2]


def _model(
    source: Source,
    vertices: Floats,
    faces: NDArray[np.int32],
    texels: NDArray[np.uint8],
    convex: ConvexParts,
    body: MassProperties,
) -> ObjectModel:
    parts = tuple(part - body.centre for part in convex.parts)
    return ObjectModel(
        name=source.name,
        category=source.category,
        vertices=vertices,
        faces=faces,
        texels=texels,
        parts=parts,
        mass=source.mass,
        inertia=body.inertia,
        friction=FRICTION,
        hull_error=convex.error,
        content_hash=content_hash(
            source.name, vertices, faces, texels, parts, source.mass, body.inertia, FRICTION
        ),
    )
