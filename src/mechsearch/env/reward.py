"""The five reward terms of the paper (section III-A), as pure functions of two states.

The paper prints the two movement terms without a sign and calls them penalties: they are
subtracted here.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from math import isfinite
from numbers import Real
from typing import Any

import numpy as np

from mechsearch.entry_point import called, is_entry_point, load_entry_point
from mechsearch.types import Array, MechSearchError

IDLENESS = ("every action", "nothing moved")

PAPER_REWARD = "paper"
"""Names the terms of the paper as the reward."""

Reward = Callable[[float, float, Array, float, bool, float, "RewardConfig"], Mapping[str, float]]
"""What `terms` is, and what a user's reward must be."""

_NOTHING_MOVED = (1.0, 1.0, np.zeros(1), 0.0, False, 0.0)


@dataclass(frozen=True)
class RewardConfig:
    """Terms of the reward, and their weights.

    Attributes:
        function: "paper", or package.module:function of a reward of one's own, which is handed
            what `terms` is handed, and returns named terms; their sum is the reward.
        uncovering: For removing all of the remaining occlusion (paper: 2.5).
        movement: For each metre that the mean non-target object, or the target, moves (paper: 75).
        gain_that_excuses: Relative uncovering from which clutter may move freely (paper: 0.05).
        workspace: For a command that leaves the workspace (paper: 0.5).
        idleness: For an action (paper: 0.5).
        idle_when: "every action", or only when "nothing moved"; the paper leaves it open.
        still: Displacement up to which an object has not moved [m].
    """

    function: str = PAPER_REWARD
    uncovering: float = 2.5
    movement: float = 75.0
    gain_that_excuses: float = 0.05
    workspace: float = 0.5
    idleness: float = 0.5
    idle_when: str = "every action"
    still: float = 1e-3

    def __post_init__(self) -> None:
        if self.function != PAPER_REWARD and not is_entry_point(str(self.function)):
            raise MechSearchError(
                f"unknown reward function {self.function!r}; expected {PAPER_REWARD!r} or "
                "package.module:function"
            )
        for name, value in vars(self).items():
            number = isinstance(value, Real) and isfinite(value)
            if name not in ("function", "idle_when") and not number:
                raise MechSearchError(f"reward.{name} is {value!r:.80}; expected a finite number")
        if self.idle_when not in IDLENESS:
            raise MechSearchError(
                f"unknown idle_when {self.idle_when!r}; choose one of {', '.join(IDLENESS)}"
            )


def uncovering_gain(before: float, after: float, least: float) -> float:
    """Return the relative change in occlusion, in [-1, 1]; positive when more is visible."""
    # Where the least is 0, a target that was in full view must not be divided by.
    return max((before - after) / max(before, least, 1e-9), -1.0)


def clutter_movement(gain: float, moved: Array, config: RewardConfig) -> float:
    """Return the heap movement penalty; `moved` (N,) [m] are the non-target displacements."""
    if gain >= config.gain_that_excuses or not len(moved):
        return 0.0
    return -config.movement * float(moved.sum()) / len(moved)


def idleness(moved: float, config: RewardConfig) -> float:
    """Return the idleness penalty; `moved` [m] is the largest displacement of an object."""
    busy = config.idle_when == "nothing moved" and moved > config.still
    return 0.0 if busy else -config.idleness


def terms(
    before: float,
    after: float,
    clutter_moved: Array,
    target_moved: float,
    leaves_workspace: bool,
    uncovered_at: float,
    config: RewardConfig,
) -> dict[str, float]:
    """Return all terms of one action; their sum is its reward.

    Args:
        before: Occlusion before the action.
        after: Occlusion after it.
        clutter_moved: Displacement of each non-target object (N,) [m].
        target_moved: Displacement of the target [m].
        leaves_workspace: Whether the command pointed outside the workspace.
        uncovered_at: Occlusion up to which the target counts as completely visible: the smallest
            denominator of the relative uncovering.
        config: Weights.
    """
    gain = uncovering_gain(before, after, uncovered_at)
    return {
        "uncovering": config.uncovering * gain,
        "clutter_movement": clutter_movement(gain, clutter_moved, config),
        "target_movement": -config.movement * target_moved,
        "workspace": -config.workspace if leaves_workspace else 0.0,
        "idleness": idleness(max(clutter_moved.max(initial=0.0), target_moved), config),
    }


def reward_of(config: RewardConfig) -> tuple[Reward, tuple[str, ...]]:
    """Return the reward that a configuration names, and the names of its terms.

    Raises:
        MechSearchError: If there is no such function, or it returns anything but finite numbers
            by name; the function that is returned raises so as well, or if the names change.
    """
    if config.function == PAPER_REWARD:
        return terms, tuple(terms(*_NOTHING_MOVED, config))
    function: Reward = load_entry_point(config.function, "reward function")
    ask = partial(called, function, "reward function", config.function)
    names = tuple(_named_numbers(ask(*_NOTHING_MOVED, config), config))

    def checked(*action: Any) -> dict[str, float]:
        found = _named_numbers(ask(*action), config)
        if found.keys() != set(names):
            raise MechSearchError(
                f"reward function {config.function!r} returned {', '.join(found)}; expected "
                f"{', '.join(names)} after every action"
            )
        return {name: found[name] for name in names}

    return checked, names


def _named_numbers(found: Any, config: RewardConfig) -> dict[str, float]:
    """Return terms as plain numbers."""
    named = isinstance(found, Mapping) and found and all(isinstance(name, str) for name in found)
    if named and all(isinstance(v, Real) and isfinite(v) for v in found.values()):
        return {name: float(value) for name, value in found.items()}
    raise MechSearchError(
        f"reward function {config.function!r} returned {found!r:.200}; expected a mapping of "
        "names to finite numbers"
    )
