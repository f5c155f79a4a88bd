"""From a mesh file and a mass to an object ready for physics and rendering.

Not every object can lie in a heap: of those that cannot, the reason is told.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from mechsearch.objects.meshes.convex import ConvexParts, parts_of, single_hull
from mechsearch.objects.meshes.hull import MassProperties, as_mesh, mass_properties
from mechsearch.objects.meshes.reading import read_pieces
from mechsearch.objects.meshes.texels import bake_texels
from mechsearch.objects.model import FRICTION, TEXEL_ROWS, ObjectModel
from mechsearch.types import Floats, MechSearchError

VERSION = 2
"""Raised with every change of the results of preparation, so that old cache files are not used."""

MOST_FACES = 1500
COLOUR_SAMPLES = 200_000

LONGEST = 0.26
SECOND_LONGEST = 0.17
LARGEST_BOX = 0.004
"""Longest sides [m] and largest bounding box [m^3] of an object in a heap."""

SMALLEST = 0.03
"""An object with no side longer than this [m] is too small to see and to push."""

LIGHTEST = 0.005
"""Contacts with neighbours a hundred times heavier than this [kg] become unstable."""

DENSITY = (20.0, 20_000.0)
"""Mass over hull volume [kg/m^3] that an object may have; outside, mass or scale is wrong."""

GROSS_ERROR = 0.02
"""Largest distance between mesh and convex parts [m] that physics can do with."""

DEFORMABLE = {"059_chain": "deformable: a chain"}
"""Objects that are not rigid, by name."""

_oriented_bounds: Callable[..., tuple[Floats, Floats]] = trimesh.bounds.oriented_bounds
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
    mesh = merge_pieces(pieces)
    try:
        whole = single_hull(mesh)
        vertices, faces = simplified(mesh)
        wrong_size = why_wrong_size(source.name, np.asarray(mesh.vertices))
        simple = trimesh.Trimesh(vertices, faces, process=False)
        convex = whole if wrong_size else parts_of(source.mesh, mesh, simple)
    except (MechSearchError, ValueError, IndexError) as error:
        raise MechSearchError(f"cannot prepare {source.name} from {source.mesh}: {error}") from None
    texels = bake_texels(vertices, faces, pieces, source.name, TEXEL_ROWS, COLOUR_SAMPLES)
    body = weigh(mesh, convex, source.mass)
    excluded = (
        wrong_size
        or why_wrong_mass(source.mass, float(mesh.convex_hull.volume))
        or why_wrong_shape(convex.error, convex.remark)
    )
    model = ObjectModel(
        source.name,
        source.category,
        vertices - body.centre,
        faces,
        texels,
        tuple(part - body.centre for part in convex.parts),
        source.mass,
        body.inertia,
        FRICTION,
        convex.error,
    )
    return Prepared(model, excluded, convex.remark)


def merge_pieces(pieces: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    """Return one plain mesh of all pieces, with equal vertices merged."""
    offsets = np.cumsum([0, *(len(piece.vertices) for piece in pieces)])
    faces = [piece.faces + offset for piece, offset in zip(pieces, offsets, strict=False)]
    vertices = np.concatenate([np.asarray(piece.vertices, np.float64) for piece in pieces])
    mesh = trimesh.Trimesh(vertices, np.concatenate(faces), process=True)
    mesh.update_faces(mesh.nondegenerate_faces() & mesh.unique_faces())
    mesh.remove_unreferenced_vertices()
    return mesh


def simplified(mesh: trimesh.Trimesh) -> tuple[Floats, NDArray[np.int32]]:
    """Return the vertices and at most 1,500 faces of a mesh.

    A mesh of very few faces is cut finer instead, so that its triangles can carry colours.
    """
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if len(faces) > MOST_FACES:
        vertices, faces = import_module("fast_simplification").simplify(
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


def why_wrong_size(name: str, points: Floats) -> str:
    """Return why a mesh (N, 3) [m] is too large, too small or not rigid, or an empty string."""
    if name in DEFORMABLE:
        return DEFORMABLE[name]
    longest, second, third = np.sort(_oriented_bounds(points)[1])[::-1]
    measured = f"{longest:.3g} x {second:.3g} x {third:.3g} m"
    if longest > LONGEST or second > SECOND_LONGEST or longest * second * third > LARGEST_BOX:
        hint = "; are its units metres?" if longest > 2 else ""
        return f"too large: {measured}{hint}"
    if longest < SMALLEST:
        return f"too small: {measured}"
    return ""


def why_wrong_mass(mass: float, volume: float) -> str:
    """Return why a mass [kg] does not fit a volume [m^3], or an empty string."""
    if mass < LIGHTEST:
        return f"too light: {1000 * mass:.3g} g"
    density = mass / volume
    if not DENSITY[0] <= density <= DENSITY[1]:
        return (
            f"its mass of {mass:.4g} kg does not fit its volume of {1e6 * volume:.4g} cm3 "
            f"({density:.3g} kg/m3)"
        )
    return ""


def why_wrong_shape(error: float, remark: str) -> str:
    """Return why convex parts with this error [m] cannot stand for a mesh, or an empty string."""
    if error > GROSS_ERROR:
        cause = f" ({remark})" if remark else ""
        return f"its convex parts are up to {1000 * error:.0f} mm from its mesh{cause}"
    return ""
