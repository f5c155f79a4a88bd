"""The zig-zag teacher (paper, section III-C): a straight push with sideways strokes."""

from collections.abc import Sequence

import numpy as np

from mechsearch.teachers.teacher import Teacher
from mechsearch.types import Floats

AMPLITUDE = 0.035
"""Sideways reach of a stroke [m]."""

STROKES = 6


class ZigzagTeacher(Teacher):
    """Sweeps across the target from side to side."""

    def path(self, target: Floats, height: float, direction: float) -> Sequence[Floats]:
        """Return the corners of the strokes."""
        along = np.array([np.cos(direction), np.sin(direction)])
        across = np.array([-along[1], along[0]])
        reach = self.config.reach
        points = []
        for i, way in enumerate(np.linspace(-reach, reach, STROKES + 1)):
            side = 0.0 if i in (0, STROKES) else AMPLITUDE * (-1) ** i
            points.append(np.array([*(target[:2] + way * along + side * across), height]))
        return points
