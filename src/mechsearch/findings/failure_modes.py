"""How an episode went: success, or one of the failures that the paper names (section V-C).

The paper shows two: actions that repeat "back-and-forth without causing any change in the
environment", and an end effector that moves "near the target object but does not interact with the
objects occluding it". Both are long stretches of actions in which nothing moves; what tells them
apart is whether the end effector keeps reversing. Random commands reverse in a quarter of their
turns.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mechsearch.evaluation.episodes import IN_HAND, EpisodeRecord
from mechsearch.types import Floats

SUCCESS = "success"
BACK_AND_FORTH = "back and forth"
HOVERING = "hovering"
ASTRAY = "astray"
STANDING = "standing still"
UNFINISHED = "unfinished"
LOST = "target lost"
FAILED_SIMULATION = "failed simulation"
EPISODE_MODES = (
    *(SUCCESS, BACK_AND_FORTH, HOVERING, ASTRAY, STANDING, UNFINISHED, LOST, FAILED_SIMULATION),
)


STILL = 1e-3
"""Displacement up to which an object has not moved in one action [m]."""

STRETCH = 20
"""Actions in a row, in which no object moves, that make an episode a failure of these kinds."""

STEP = 5e-3
"""Displacement from which the end effector has moved in one action [m]."""

REVERSAL = np.radians(120)
"""Angle between successive moves from which the second reverses the first [rad]."""

REVERSALS = 0.4
"""Share of reversals among the turns of the stretch that make it back and forth."""

NEAR = 0.15
"""Median horizontal distance to the target up to which the end effector is near it [m]."""

LEAST_MOVES = 0.25
"""Share of moves in the stretch below which the end effector stands still."""


class EpisodeMode(NamedTuple):
    """How one episode went.

    Attributes:
        mode: One of `EPISODE_MODES`.
        stretch: Most actions in a row in which no object moved.
    """

    mode: str
    stretch: int


DEFINITION = (
    f"An episode that ends uncovered is a success. Any other in which no object moves by more than "
    f"{STILL * 1000:.0f} mm for {STRETCH} actions in a row is judged by its longest such stretch: "
    f"“{STANDING}” if the end effector moves {STEP * 1000:.0f} mm or more in less than "
    f"{LEAST_MOVES:.0%} of the actions; “{BACK_AND_FORTH}” if at least {REVERSALS:.0%} of its "
    f"successive moves turn by {np.degrees(REVERSAL):.0f}° or more (random commands do in a "
    f"quarter); else “{HOVERING}” if it is mostly within {NEAR * 100:.0f} cm of the target, seen "
    f"from above, and “{ASTRAY}” if not. The remaining ones are “{UNFINISHED}” (it moved objects "
    f"now and then), “{LOST}” or “{FAILED_SIMULATION}”."
)
"""The modes in words."""


def mode_of(record: EpisodeRecord) -> EpisodeMode:
    """Return how an episode went."""
    moved = np.linalg.norm(np.diff(record.poses[:, :, :3], axis=0), axis=2).max(axis=1)
    first, last = longest_run(moved <= STILL)
    return EpisodeMode(_mode(record, first, last), last - first)


def _mode(record: EpisodeRecord, first: int, last: int) -> str:
    if record.uncovered or record.end == IN_HAND:
        return SUCCESS
    if record.end == "lost":
        return LOST
    if record.end.startswith("failure"):
        return FAILED_SIMULATION
    if last - first < STRETCH:
        return UNFINISHED
    path = record.ee_positions[first : last + 1]
    steps = np.diff(path, axis=0)
    moves = steps[np.linalg.norm(steps, axis=1) >= STEP]
    if len(moves) < LEAST_MOVES * len(steps):
        return STANDING
    if reversal_share(moves, REVERSAL) >= REVERSALS:
        return BACK_AND_FORTH
    target = record.poses[first : last + 1, record.target, :2]
    distance = np.median(np.linalg.norm(path[:, :2] - target, axis=1))
    return HOVERING if distance <= NEAR else ASTRAY


def longest_run(flags: NDArray[np.bool_]) -> tuple[int, int]:
    """Return the first longest run of true flags as (start, end), end excluded."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    if not len(edges):
        return 0, 0
    starts, ends = edges[::2], edges[1::2]
    longest = int(np.argmax(ends - starts))
    return int(starts[longest]), int(ends[longest])


def reversal_share(moves: Floats, angle: float) -> float:
    """Return the share of successive moves (K, 3) that turn by `angle` [rad] or more."""
    if len(moves) < 2:
        return 0.0
    lengths = np.linalg.norm(moves, axis=1)
    cosines = (moves[1:] * moves[:-1]).sum(axis=1) / (lengths[1:] * lengths[:-1])
    # Rounding must not lose an exact reversal.
    return float((cosines <= np.cos(angle) + 1e-9).mean())
