"""A push as numbers: the teachers' shapes, with their place, length and height left open."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mechsearch.teachers.spiral import INNER, OUTER, POINTS, TURNS
from mechsearch.types import Floats, MechSearchError

KINDS = ("straight", "spiral")
"""Shapes of a push, named after the teachers (paper, section III-C). Of random pushes on YCB heaps,
zig-zags were the best of six a third less often than they were drawn, and spirals half as often
again."""

_STRAIGHT_SHARE = 0.7


@dataclass(frozen=True)
class Push:
    """One push, relative to where the target is seen.

    Attributes:
        kind: Shape: "straight" or "spiral".
        direction: In which it goes, or in which a spiral sets out [rad].
        lateral: How far to the left of the target's middle a straight push passes [m].
        before: Where a straight push begins, ahead of the target's middle [m].
        after: Where it ends, beyond it [m].
        turns: Of a spiral; each leads 5.5 cm further out.
        height: Of the fingertip above the target's visible middle [m].
        mirrored: Whether a spiral turns clockwise.
    """

    kind: str
    direction: float
    lateral: float = 0.0
    before: float = 0.0
    after: float = 0.0
    turns: float = 0.0
    height: float = 0.0
    mirrored: bool = False

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise MechSearchError(
                f"unknown kind of push {self.kind!r}; choose one of {', '.join(KINDS)}"
            )
        if (self.before + self.after if self.kind == "straight" else self.turns) <= 0:
            raise MechSearchError(
                f"a {self.kind} push of {self.before} + {self.after} m and {self.turns} turns has "
                "no length; expected more than 0"
            )

    @property
    def axes(self) -> tuple[Floats, Floats]:
        """The push's own axes (2,) each: along it, and to the left, or right where mirrored."""
        along = np.array([np.cos(self.direction), np.sin(self.direction)])
        side = -1.0 if self.mirrored else 1.0
        return along, side * np.array([-along[1], along[0]])

    def middle(self, centre: Floats) -> Floats:
        """Return the point (2,) [m] that it passes beside or through a target at `centre`."""
        along, _ = self.axes
        return centre[:2] + self.lateral * np.array([-along[1], along[0]])

    def path(self, centre: Floats, height: float) -> Sequence[Floats]:
        """Return its waypoints (3,) [m].

        Args:
            centre: Middle of the visible target (3,) [m].
            height: Of the fingertip [m].
        """
        along, across = self.axes
        if self.kind == "spiral":
            turned = np.linspace(0, self.turns, max(round(self.turns / TURNS * POINTS), 3))
            radii, angles = INNER + (OUTER - INNER) / TURNS * turned, 2 * np.pi * turned
            ways = np.outer(radii * np.cos(angles), along) + np.outer(
                radii * np.sin(angles), across
            )
        else:
            ways = np.outer([-self.before, self.after], along)
        points = self.middle(centre) + ways
        return [np.array([x, y, height]) for x, y in points]


def draw_pushes(count: int, rng: np.random.Generator) -> list[Push]:
    """Return random pushes from all sides; lengths and heights are those that often do well."""
    return [_draw(rng) for _ in range(count)]


def _draw(rng: np.random.Generator) -> Push:
    direction, height = float(rng.uniform(0, 2 * np.pi)), float(rng.uniform(-0.012, 0.035))
    if rng.random() < _STRAIGHT_SHARE:
        lateral, before = float(rng.normal(0, 0.025)), float(rng.uniform(0, 0.11))
        after = float(rng.uniform(0.03, 0.15))
        return Push("straight", direction, lateral, before, after, height=height)
    lateral, turns = float(rng.normal(0, 0.01)), float(rng.uniform(0.75, TURNS))
    mirrored = bool(rng.random() < 0.5)
    return Push("spiral", direction, lateral, turns=turns, height=height, mirrored=mirrored)
