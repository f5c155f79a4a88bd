"""Shapes of pushes (paper, section III-C), and pushes that vary their place and length."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mechsearch.types import Floats, MechSearchError

Shape = Callable[[Floats, float], Floats]
"""Returns the waypoints (N, 2) [m] of a push about a point (2,) [m], in a direction [rad]."""

REACH = 0.15
"""Horizontal distance from the target at which a teacher's push begins and ends [m]."""

AMPLITUDE, STROKES = 0.035, 6
"""Sideways reach of a zig-zag's stroke [m], and their number."""

INNER, OUTER, SPIRAL_TURNS, SPIRAL_POINTS = 0.02, 0.13, 2.0, 20
"""First and last radius of a teacher's spiral [m], its turns, and its waypoints."""


def straight(
    middle: Floats, direction: float, before: float = REACH, after: float = REACH
) -> Floats:
    """Return both ends (2, 2) of a line through `middle` (2,), from `before` to `after` it [m]."""
    return middle + np.outer([-before, after], _unit(direction))


def zigzag(middle: Floats, direction: float, reach: float = REACH) -> Floats:
    """Return the corners (N, 2) of strokes from side to side of such a line."""
    along = _unit(direction)
    across = np.array([-along[1], along[0]])
    sides = AMPLITUDE * np.array([0, *(-1) ** np.arange(1, STROKES), 0])
    ways = np.linspace(-reach, reach, STROKES + 1)
    return middle + np.outer(ways, along) + np.outer(sides, across)


def spiral(
    middle: Floats, direction: float, turns: float = SPIRAL_TURNS, mirrored: bool = False
) -> Floats:
    """Return points (N, 2) outwards from near `middle`, counter-clockwise if not `mirrored`."""
    turned = np.linspace(0, turns, max(round(turns / SPIRAL_TURNS * SPIRAL_POINTS), 3))
    radii = INNER + (OUTER - INNER) / SPIRAL_TURNS * turned
    angles = direction + (-2 if mirrored else 2) * np.pi * turned
    return middle + np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1)


def _unit(direction: float) -> Floats:
    return np.array([np.cos(direction), np.sin(direction)])


KINDS = ("straight", "spiral")
"""Shapes to choose among. Of random pushes on YCB heaps, zig-zags were the best of six a third less
often than they were drawn, and spirals half as often again."""

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
        along = _unit(self.direction)
        side = -1.0 if self.mirrored else 1.0
        return along, side * np.array([-along[1], along[0]])

    def middle(self, centre: Floats) -> Floats:
        """Return the point (2,) [m] that it passes beside or through a target at `centre`."""
        along = _unit(self.direction)
        return centre[:2] + self.lateral * np.array([-along[1], along[0]])

    def path(self, centre: Floats) -> Floats:
        """Return its waypoints (N, 2) [m] about a target at `centre`."""
        middle = self.middle(centre)
        if self.kind == "spiral":
            return spiral(middle, self.direction, self.turns, self.mirrored)
        return straight(middle, self.direction, self.before, self.after)


def draw_pushes(count: int, rng: np.random.Generator) -> list[Push]:
    """Return random pushes from all sides; lengths and heights are those that often do well."""
    return [_draw(rng) for _ in range(count)]


def _draw(rng: np.random.Generator) -> Push:
    direction, height = float(rng.uniform(0, 2 * np.pi)), float(rng.uniform(-0.012, 0.035))
    if rng.random() < _STRAIGHT_SHARE:
        lateral, before = float(rng.normal(0, 0.025)), float(rng.uniform(0, 0.11))
        after = float(rng.uniform(0.03, 0.15))
        return Push("straight", direction, lateral, before, after, height=height)
    lateral, turns = float(rng.normal(0, 0.01)), float(rng.uniform(0.75, SPIRAL_TURNS))
    mirrored = bool(rng.random() < 0.5)
    return Push("spiral", direction, lateral, turns=turns, height=height, mirrored=mirrored)
