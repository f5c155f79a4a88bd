"""The five reward terms of the paper (section III-A), as pure functions of two states.

The paper prints the two movement terms without a sign and calls them penalties: they are
subtracted here.
"""

from dataclasses import dataclass

from mechsearch.types import Array, MechSearchError

IDLENESS = ("every action", "nothing moved")


@dataclass(frozen=True)
class RewardConfig:
    """Weights of the terms.

    Attributes:
        uncovering: For removing all of the remaining occlusion (paper: 2.5).
        movement: For each metre that the mean non-target object, or the target, moves (paper: 75).
        gain_that_excuses: Relative uncovering from which clutter may move freely (paper: 0.05).
        workspace: For a command that leaves the workspace (paper: 0.5).
        idleness: For an action (paper: 0.5).
        idle_when: "every action", or only when "nothing moved"; the paper leaves it open.
        least_occlusion: Smallest denominator of the relative uncovering: below it the target
            counts as completely visible.
        still: Displacement up to which an object has not moved [m].
    """

    uncovering: float = 2.5
    movement: float = 75.0
    gain_that_excuses: float = 0.05
    workspace: float = 0.5
    idleness: float = 0.5
    idle_when: str = "every action"
    least_occlusion: float = 0.02
    still: float = 1e-3

    def __post_init__(self) -> None:
        if self.idle_when not in IDLENESS:
            raise MechSearchError(
                f"unknown idle_when {self.idle_when!r}; choose one of {', '.join(IDLENESS)}"
            )


@dataclass(frozen=True)
class RewardTerms:
    """One action's reward, term by term; their sum is the reward."""

    uncovering: float
    clutter_movement: float
    target_movement: float
    workspace: float
    idleness: float

    @property
    def total(self) -> float:
        """The reward."""
        return float(sum(vars(self).values()))


NO_REWARD = RewardTerms(0.0, 0.0, 0.0, 0.0, 0.0)


def uncovering_gain(before: float, after: float, least: float) -> float:
    """Return the relative change in occlusion, in [-1, 1]; positive when more is visible."""
    return max((before - after) / max(before, least), -1.0)


def uncovering(gain: float, config: RewardConfig) -> float:
    """Return the target uncovering reward for a relative gain."""
    return config.uncovering * gain


def clutter_movement(gain: float, moved: Array, config: RewardConfig) -> float:
    """Return the heap movement penalty; `moved` (N,) [m] are the non-target displacements."""
    if gain >= config.gain_that_excuses or not len(moved):
        return 0.0
    return -config.movement * float(moved.sum()) / len(moved)


def target_movement(moved: float, config: RewardConfig) -> float:
    """Return the target movement penalty for a displacement [m]."""
    return -config.movement * moved


def workspace(leaves: bool, config: RewardConfig) -> float:
    """Return the workspace limits penalty."""
    return -config.workspace if leaves else 0.0


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
    config: RewardConfig,
) -> RewardTerms:
    """Return all terms of one action.

    Args:
        before: Occlusion before the action.
        after: Occlusion after it.
        clutter_moved: Displacement of each non-target object (N,) [m].
        target_moved: Displacement of the target [m].
        leaves_workspace: Whether the command pointed outside the workspace.
        config: Weights.
    """
    gain = uncovering_gain(before, after, config.least_occlusion)
    return RewardTerms(
        uncovering=uncovering(gain, config),
        clutter_movement=clutter_movement(gain, clutter_moved, config),
        target_movement=target_movement(target_moved, config),
        workspace=workspace(leaves_workspace, config),
        idleness=idleness(max(clutter_moved.max(initial=0.0), target_moved), config),
    )
