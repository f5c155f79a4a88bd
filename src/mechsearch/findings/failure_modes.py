"""How an episode went: success, or one of the failures that the paper names (section V-C).

The paper shows two: actions that repeat "back-and-forth without causing any change in the
environment", and an end effector that moves "near the target object but does not interact with the
objects occluding it". Both are long stretches of actions in which nothing moves; what tells them
apart is whether the end effector keeps reversing. Random commands reverse in a quarter of their
turns.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mechsearch.evaluation.episodes import EpisodeRecord
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


@dataclass(frozen=True)
class ModeConfig:
    """Thresholds.

    Attributes:
        still: Displacement up to which an object has not moved in one action [m].
        stretch: Actions in a row, in which no object moves, that make an episode a failure of
            these kinds.
        step: Displacement from which the end effector has moved in one action [m].
        reversal: Angle between successive moves from which the second reverses the first [rad].
        reversals: Share of reversals among the turns of the stretch that make it back and forth.
        near: Median horizontal distance to the target up to which the end effector is near it [m].
        standing: Share of moves in the stretch below which the end effector stands still.
    """

    still: float = 1e-3
    stretch: int = 20
    step: float = 5e-3
    reversal: float = np.radians(120)
    reversals: float = 0.4
    near: float = 0.15
    standing: float = 0.25


class EpisodeMode(NamedTuple):
    """How one episode went.

    Attributes:
        mode: One of `EPISODE_MODES`.
        stretch: Most actions in a row in which no object moved.
    """

    mode: str
    stretch: int


DEFAULT = ModeConfig()


def definition(config: ModeConfig = DEFAULT) -> str:
    """Return in words what the modes are."""
    turn = f"{np.degrees(config.reversal):.0f}°"
    return (
        f"An episode that ends uncovered is a success. Any other in which no object moves by more "
        f"than {config.still * 1000:.0f} mm for {config.stretch} actions in a row is judged by its "
        f"longest such stretch: “{STANDING}” if the end effector moves {config.step * 1000:.0f} mm "
        f"or more in less than {config.standing:.0%} of the actions; “{BACK_AND_FORTH}” if at "
        f"least {config.reversals:.0%} of its successive moves turn by {turn} or more (random "
        f"commands do in a quarter); else “{HOVERING}” if it is mostly within "
        f"{config.near * 100:.0f} cm of the target, seen from above, and “{ASTRAY}” if not. The "
        f"remaining ones are “{UNFINISHED}” (it moved objects now and then), “{LOST}” or "
        f"“{FAILED_SIMULATION}”."
    )


def mode_of(record: EpisodeRecord, config: ModeConfig = DEFAULT) -> EpisodeMode:
    """Return how an episode went."""
    first, last = longest_run(largest_movement(record) <= config.still)
    stretch = last - first
    if record.uncovered:
        return EpisodeMode(SUCCESS, stretch)
    if record.end == "lost":
        return EpisodeMode(LOST, stretch)
    if record.end.startswith("failure"):
        return EpisodeMode(FAILED_SIMULATION, stretch)
    if stretch < config.stretch:
        return EpisodeMode(UNFINISHED, stretch)
    path = record.ee_positions[first : last + 1]
    target = record.poses[first : last + 1, record.target, :2]
    distance = float(np.median(np.linalg.norm(path[:, :2] - target, axis=1)))
    return EpisodeMode(_stuck(np.diff(path, axis=0), distance, config), stretch)


def largest_movement(record: EpisodeRecord) -> Floats:
    """Return how far the object that moved most went in each action (T,) [m]."""
    steps = np.linalg.norm(np.diff(record.poses[:, :, :3], axis=0), axis=2)
    largest: Floats = steps.max(axis=1)
    return largest


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


def _stuck(steps: Floats, distance: float, config: ModeConfig) -> str:
    moves = steps[np.linalg.norm(steps, axis=1) >= config.step]
    if len(moves) < config.standing * len(steps):
        return STANDING
    if reversal_share(moves, config.reversal) >= config.reversals:
        return BACK_AND_FORTH
    return HOVERING if distance <= config.near else ASTRAY
