"""The straight teacher (paper, section III-C): a random straight push above the target."""

from collections.abc import Sequence

import numpy as np

from mechsearch.teachers.teacher import Teacher
from mechsearch.types import Floats


class StraightTeacher(Teacher):
    """Sweeps across the target in one line."""

    def path(self, target: Floats, height: float, direction: float) -> Sequence[Floats]:
        """Return both ends of the sweep."""
        along = self.config.reach * np.array([np.cos(direction), np.sin(direction)])
        return [
            np.array([*(target[:2] - along), height]),
            np.array([*(target[:2] + along), height]),
        ]
