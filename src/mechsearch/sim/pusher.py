"""The end effector: two closed fingers as one vertical capsule, position-controlled."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from mechsearch.objects.model import ObjectModel
from mechsearch.types import Floats

_UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class Pusher:
    """Geometry and control of the closed fingers. Its position is its lowest point.

    Attributes:
        radius: Of the capsule [m].
        length: From tip to top [m].
        mass: [kg].
        stiffness: Of the position controller [N/m].
        force: Largest force along each axis [N].
        friction: Sliding coefficient.
    """

    radius: float = 0.012
    length: float = 0.2
    mass: float = 0.3
    stiffness: float = 2000.0
    force: float = 25.0
    friction: float = 0.5

    def pose(self, position: Floats) -> Floats:
        """Return the pose (7,) of the visual model for a tip at `position` (3,)."""
        return np.concatenate([position, _UPRIGHT])


@cache
def pusher_model(pusher: Pusher, sides: int = 16, rings: int = 4) -> ObjectModel:
    """Return the pusher's mesh for rendering, its origin at the tip."""
    angles = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    lifts = np.linspace(-np.pi / 2, 0, rings + 1)[1:]
    radius, top = pusher.radius, pusher.length
    heights = [radius + radius * np.sin(a) for a in lifts]
    heights += [top - h for h in reversed(heights)]
    radii = [radius * np.cos(a) for a in lifts]
    radii += list(reversed(radii))
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    rows = [
        np.column_stack([circle * r, np.full(sides, h)])
        for r, h in zip(radii, heights, strict=True)
    ]
    vertices = np.concatenate([[[0.0, 0.0, 0.0]], *rows, [[0.0, 0.0, top]]])
    faces: list[tuple[int, int, int]] = []
    last = len(vertices) - 1
    for i in range(sides):
        j = (i + 1) % sides
        faces.append((0, 1 + j, 1 + i))
        for row in range(len(rows) - 1):
            a, b = 1 + row * sides, 1 + (row + 1) * sides
            faces += [(a + i, a + j, b + j), (a + i, b + j, b + i)]
        top_row = 1 + (len(rows) - 1) * sides
        faces.append((top_row + i, top_row + j, last))
    indices = np.array(faces, np.int32)
    texels = np.full((len(indices), 1, 3), (60, 64, 72), np.uint8)
    return ObjectModel(
        "pusher", "robot", vertices, indices, texels, (vertices,), pusher.mass,
        np.eye(3) * 1e-4, pusher.friction, 0.0,
    )  # fmt: skip
