"""The spiral teacher (paper, section III-C): from near the target, outwards in a spiral."""

from collections.abc import Sequence

import numpy as np

from mechsearch.teachers.teacher import Teacher
from mechsearch.types import Floats

INNER, OUTER = 0.02, 0.13
"""First and last radius [m]."""

TURNS, POINTS = 2.0, 20


class SpiralTeacher(Teacher):
    """Spirals out from above the target, counter-clockwise."""

    def path(self, target: Floats, height: float, direction: float) -> Sequence[Floats]:
        """Return points along the spiral."""
        part = np.linspace(0, 1, POINTS)
        angles = direction + 2 * np.pi * TURNS * part
        radii = INNER + (OUTER - INNER) * part
        x, y = target[0] + radii * np.cos(angles), target[1] + radii * np.sin(angles)
        return [np.array([a, b, height]) for a, b in zip(x, y, strict=True)]
