"""How an episode went: success, or one of the failures that the paper names (section V-C).

The paper shows two: actions that repeat "back-and-forth without causing any change in the
environment", and an end effector that moves "near the target object but does not interact with the
objects occluding it". Both are long stretches of actions in which nothing moves; what tells them
apart is whether the end effector keeps reversing. Random commands reverse in a quarter of their
turns.

A retrieval that fails is named after what came of its last grasps.
"""

from collections import Counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mechsearch.evaluation.episodes import IN_HAND, EpisodeRecord
from mechsearch.types import GRASP, USED_UP, Floats, Outcome

SUCCESS = "success"
BACK_AND_FORTH = "back and forth"
HOVERING = "hovering"
ASTRAY = "astray"
STANDING = "standing still"
UNFINISHED = "unfinished"
LOST = "target lost"
FAILED_SIMULATION = "failed simulation"
UNCOVERING_MODES = (
    *(SUCCESS, BACK_AND_FORTH, HOVERING, ASTRAY, STANDING, UNFINISHED, LOST, FAILED_SIMULATION),
)
"""How episodes end in which the target is to be uncovered only."""

NEVER_GRASPED = "never grasped"
GRASP_MODES = (
    *map(str, (Outcome.BLOCKED, Outcome.MISSED, Outcome.NO_SEAL, Outcome.SLIPPED, Outcome.DROPPED)),
    *map(str, (Outcome.WRONG_OBJECT, Outcome.TWO_OBJECTS)),
    NEVER_GRASPED,
)
RETRIEVAL_MODES = (SUCCESS, *GRASP_MODES, LOST, FAILED_SIMULATION)
"""How episodes of retrieval end."""

EPISODE_MODES = (*UNCOVERING_MODES, *GRASP_MODES)
"""All of them; compact scores know them by their place, so that new ones come last."""

LAST_GRASPS = 3
"""Grasps of the target, the last ones, after which a failed retrieval is named."""


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

RETRIEVAL_DEFINITION = (
    "An episode that ends with the target in the hand is a success. Any other is named after what "
    f"most of its last {LAST_GRASPS} grasps of the target came to, or after the last of them if no "
    "two are alike: “blocked” (something was in the fingers' way), “missed” (the target was not "
    "between them), “no seal” (of suction), “slipped” (on the way up), “dropped” (in the shake), "
    f"“wrong object” or “two objects” (came up); “{NEVER_GRASPED}” if there was none. The others "
    f"are “{LOST}” (off the table) or “{FAILED_SIMULATION}”."
)
"""The modes of retrieval in words."""


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
    if record.retrieval:
        return _mode_of_grasps(record)
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


def _mode_of_grasps(record: EpisodeRecord) -> str:
    """Return what most of the last grasps of the target came to."""
    assert record.retrieval is not None
    pairs = zip(record.actions[:, 0].tolist(), record.retrieval.outcomes, strict=True)
    grasps = [said for kind, said in pairs if kind == GRASP and said != USED_UP]
    # The later comes first, and of as many the first is taken.
    latest = Counter(grasps[-LAST_GRASPS:][::-1])
    return latest.most_common(1)[0][0] if latest else NEVER_GRASPED


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
