"""Carries out what is proposed action by action, such as a push, and records what it came to."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mechsearch.env.heap_env import HeapEnv
from mechsearch.types import TEACHER_KEYS, Array, Observation


@dataclass
class Rollout:
    """How it went.

    Attributes:
        obs: The last observation.
        actions: As proposed, (3,) each.
        reward: Sum of all terms.
        terms: Each term's sum.
        clutter_moved: Sum over the actions of the mean non-target displacement [m].
        end: How the episode ended with it, "given up", or None.
        occlusion: Of the target afterwards.
    """

    obs: Observation
    actions: list[NDArray[np.float32]] = field(default_factory=list)
    reward: float = 0.0
    terms: dict[str, float] = field(default_factory=dict)
    clutter_moved: float = 0.0
    end: str | None = None
    occlusion: float = 1.0


def roll_out(
    env: HeapEnv,
    obs: Observation,
    propose: Callable[[Observation], NDArray[np.float32] | None],
    is_hopeless: Callable[[Rollout], bool] = lambda rollout: False,
) -> Rollout:
    """Carry out actions until there are no more, the episode ends, or they are given up.

    Args:
        env: Where.
        obs: Its present observation.
        propose: Returns the next action (3,) for an observation, or None at the end.
        is_hopeless: Asked after each action whether to give up.
    """
    rollout = Rollout(obs)
    while rollout.end is None and (action := propose(rollout.obs)) is not None:
        rollout.obs, reward, _, _, info = env.step(action)
        rollout.actions.append(action)
        rollout.reward += reward
        for name, value in info["reward_terms"].items():
            rollout.terms[name] = rollout.terms.get(name, 0.0) + value
        rollout.clutter_moved += info["clutter_moved"]
        rollout.occlusion = info["occlusion"]
        rollout.end = "given up" if is_hopeless(rollout) else info["end"]
    return rollout


def imageless(env: HeapEnv) -> HeapEnv:
    """Return a copy of an environment that takes its snapshots, and observes positions alone."""
    return HeapEnv(env.heaps, env.objects, replace(env.config, keys=TEACHER_KEYS, privileged=True))


def from_start(snapshot: dict[str, Array]) -> dict[str, Array]:
    """Return a snapshot as if the episode began there, with all its actions left."""
    return snapshot | {"actions": np.zeros_like(snapshot["actions"])}
