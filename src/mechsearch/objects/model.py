"""One rigid object, ready for physics and rendering."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mechsearch.types import Floats


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """Geometry and inertia in the object frame, whose origin is the centre of mass.

    Attributes:
        name: Unique in its set.
        category: Such as "can" or "tool"; free text.
        vertices: Visual mesh (V, 3) [m].
        faces: Triangles (F, 3), vertex indices, counter-clockwise from outside.
        texels: Colour of each triangle (F, T, 3) uint8: T = n (n + 1) / 2 samples on a barycentric
            grid of n rows. Cell (i, j), i + j < n, stands at index i n - i (i - 1) / 2 + j and
            holds the colour where the second vertex weighs u in [i / n, (i + 1) / n) and the third
            v in [j / n, (j + 1) / n); sample it at u = (i + 1/3) / n, v = (j + 1/3) / n. T = 1 is
            one colour for each triangle.
        parts: Convex parts for physics, each the vertices (P, 3) [m] of its hull.
        mass: [kg].
        inertia: About the origin (3, 3) [kg m^2].
        friction: Sliding coefficient.
        hull_error: Largest distance between mesh and convex parts [m].
        content_hash: SHA-256 of what the object is made from: its arrays, or the files and settings
            of its preparation.
    """

    name: str
    category: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    texels: NDArray[np.uint8]
    parts: tuple[Floats, ...]
    mass: float
    inertia: Floats
    friction: float
    hull_error: float
    content_hash: str

    @property
    def radius(self) -> float:
        """Radius of the sphere about the centre of mass that holds the mesh [m]."""
        return float(np.linalg.norm(self.vertices, axis=1).max())


@dataclass(frozen=True, eq=False)
class ObjectSet:
    """A named set of objects.

    Attributes:
        name: Such as "household" or "ycb".
        models: Objects that can lie in a heap, by name, in a fixed order.
        excluded: Objects that cannot, each with the reason.
    """

    name: str
    models: Mapping[str, ObjectModel]
    excluded: Mapping[str, str]
