"""One rigid object, ready for physics and rendering, its identity, and sets of them."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mechsearch.types import Array, Floats, MechSearchError

FRICTION = 0.5
"""Sliding coefficient of an object whose own is unknown; about wood on wood."""

TEXEL_ROWS = 6
"""Rows of the grid of colours on a triangle."""

FLAGGED_ERROR = 0.005
"""Distance between mesh and convex parts [m] above which an object is flagged, not excluded."""


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
        content_hash: SHA-256 (64 hexadecimal digits) of what the object is made from: the files and
            settings of its preparation or, by default, its arrays.
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
    content_hash: str = ""

    def __post_init__(self) -> None:
        if not self.content_hash:
            object.__setattr__(self, "content_hash", self._digest())

    def _digest(self) -> str:
        """Return a digest that is the same on every machine for equal objects.

        Every array is hashed with its shape in a fixed type and byte order, and -0 as 0, so that no
        two different lists of arrays look alike.
        """
        digest = hashlib.sha256(f"{self.name!r}".encode())
        arrays: list[Array] = [
            np.asarray(self.vertices, "<f8"),
            np.asarray(self.faces, "<i4"),
            np.asarray(self.texels, "u1"),
            *(np.asarray(value, "<f8") for value in (self.mass, self.inertia, self.friction)),
            *(np.asarray(part, "<f8") for part in self.parts),
        ]
        for array in arrays:
            digest.update(f"{array.dtype.str}{array.shape}".encode())
            digest.update((array + array.dtype.type(0)).tobytes())
        return digest.hexdigest()

    @property
    def radius(self) -> float:
        """Radius of the sphere about the centre of mass that holds the mesh [m]."""
        return float(np.linalg.norm(self.vertices, axis=1).max())

    @property
    def flagged(self) -> bool:
        """Whether its parts stray over 5 mm from its mesh."""
        return self.hull_error > FLAGGED_ERROR


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

    @property
    def hashes(self) -> dict[str, str]:
        """Content hash of each object, by name."""
        return {name: model.content_hash for name, model in self.models.items()}

    def choose(self, only: Sequence[str] = (), without: Sequence[str] = ()) -> "ObjectSet":
        """Return the set of some of its objects.

        Args:
            only: Names of those to keep; empty keeps all.
            without: Names of those to leave out.

        Raises:
            MechSearchError: If there is no object of such a name.
        """
        unknown = [name for name in (*only, *without) if name not in self.models]
        if unknown:
            raise MechSearchError(
                f"object set {self.name!r} has no {', '.join(unknown)}; choose among "
                f"{', '.join(self.models)}"
            )
        kept = {
            k: v for k, v in self.models.items() if (not only or k in only) and k not in without
        }
        return ObjectSet(self.name, kept, self.excluded)

    def differing(self, recorded: Mapping[str, str]) -> list[str]:
        """Return the names, of recorded content hashes, that are missing or have another here."""
        present = self.hashes
        return sorted(name for name in recorded if present.get(name) != recorded[name])


def texel_weights(rows: int, inset: float) -> Floats:
    """Return barycentric coordinates (T, 3) of one point in each texel of `ObjectModel`'s grid.

    Args:
        rows: Of the grid, so that T = rows (rows + 1) / 2.
        inset: Of the point from the corner where its cell begins, as a share of the cell's side.
    """
    cells = [(i, j) for i in range(rows) for j in range(rows - i)]
    second, third = (np.array(cells, np.float64).T + inset) / rows
    return np.stack([1 - second - third, second, third], axis=1)
