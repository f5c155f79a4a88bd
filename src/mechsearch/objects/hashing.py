"""The identity of an object: a digest of all that physics and rendering read."""

import hashlib
from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from mechsearch.types import Array


def content_hash(
    name: str,
    vertices: ArrayLike,
    faces: ArrayLike,
    texels: ArrayLike,
    parts: Iterable[ArrayLike],
    mass: float,
    inertia: ArrayLike,
    friction: float,
) -> str:
    """Return a SHA-256 digest (64 hexadecimal digits) of one object.

    Every array is hashed with its shape in a fixed type and byte order, and -0 as 0, so equal
    objects have equal digests on every machine, and no two different lists of arrays look alike.

    Args:
        name: Of the object.
        vertices: Visual mesh (V, 3) [m].
        faces: Triangles (F, 3), vertex indices.
        texels: Colours (F, T, 3) uint8.
        parts: Convex parts, each (P, 3) [m].
        mass: [kg].
        inertia: About the origin (3, 3) [kg m^2].
        friction: Sliding coefficient.
    """
    digest = hashlib.sha256(f"{name!r}".encode())
    arrays: list[Array] = [
        np.asarray(vertices, "<f8"),
        np.asarray(faces, "<i4"),
        np.asarray(texels, "u1"),
        np.asarray(mass, "<f8"),
        np.asarray(inertia, "<f8"),
        np.asarray(friction, "<f8"),
        *(np.asarray(part, "<f8") for part in parts),
    ]
    for array in arrays:
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update((array + array.dtype.type(0)).tobytes())
    return digest.hexdigest()
