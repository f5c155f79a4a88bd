"""Carries out what is proposed action by action, such as a push, and records what it came to."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from mechsearch.env.decision import Decision
from mechsearch.env.heap_env import HeapEnv
from mechsearch.env.retrieve_env import RetrieveEnv
from mechsearch.pushes.push import PlannedPush
from mechsearch.types import TEACHER_KEYS, Array, Observation

Env = TypeVar("Env", HeapEnv, RetrieveEnv)

_SPENT = ("actions", "grasps", "removals")


@dataclass
class Rollout:
    """How it went.

    Attributes:
        obs: The last observation.
        actions: As proposed, (3,) each, or (9,) in retrieval.
        reward: Sum of all terms.
        terms: Each term's sum.
        clutter_moved: Sum over the actions of the mean non-target displacement [m].
        end: How the episode ended with it, "given up", or None.
        occlusion: Of the target afterwards.
        info: Of the last action.
    """

    obs: Observation
    actions: list[Array] = field(default_factory=list)
    reward: float = 0.0
    terms: dict[str, float] = field(default_factory=dict)
    clutter_moved: float = 0.0
    end: str | None = None
    occlusion: float = 1.0
    info: Mapping[str, Any] = field(default_factory=dict)


def roll_out(
    env: HeapEnv | RetrieveEnv,
    obs: Observation,
    propose: Callable[[Observation], Array | None],
    is_hopeless: Callable[[Rollout], bool] = lambda rollout: False,
) -> Rollout:
    """Carry out actions until there are no more, the episode ends, or they are given up.

    Args:
        env: Where.
        obs: Its present observation.
        propose: Returns the next action for an observation, or None at the end.
        is_hopeless: Asked after each action whether to give up.
    """
    rollout = Rollout(obs)
    while rollout.end is None and (action := propose(rollout.obs)) is not None:
        rollout.obs, reward, _, _, info = env.step(action)
        rollout.actions.append(action)
        rollout.info = info
        rollout.reward += reward
        for name, value in info["reward_terms"].items():
            rollout.terms[name] = rollout.terms.get(name, 0.0) + value
        rollout.clutter_moved += info["clutter_moved"]
        rollout.occlusion = info["occlusion"]
        rollout.end = "given up" if is_hopeless(rollout) else info["end"]
    return rollout


def imageless(env: Env) -> Env:
    """Return a copy of an environment that takes its snapshots, and observes positions alone.

    The simulator says there when the target is uncovered.
    """
    config = replace(env.config, keys=TEACHER_KEYS, privileged=True, stop=type(env.config).stop)
    return type(env)(env.heaps, env.objects, config)


def through(env: Env, sensor: str) -> Env:
    """Return a copy of an environment that sees by another sensor, and takes its snapshots.

    These need the number of an "episode" beside, on which errors depend.
    """
    return type(env)(env.heaps, env.objects, replace(env.config, sensor=sensor))


def from_start(snapshot: dict[str, Array]) -> dict[str, Array]:
    """Return a snapshot as if the episode began there, with all its actions left."""
    spent = {name: snapshot[name] for name in _SPENT if name in snapshot}
    return snapshot | {name: np.zeros_like(count) for name, count in spent.items()}


Propose = Callable[[Observation], Array | None]
"""Returns the vector (9,) of the next decision, or None at the end."""


def pushing(planned: PlannedPush) -> Propose:
    """Return what proposes a push from its beginning to its end."""

    def propose(obs: Observation) -> Array | None:
        action = planned.act(obs)
        return None if action is None else Decision.push(action).vector()

    return propose


def once(decision: Decision) -> Propose:
    """Return what proposes a decision, and then nothing more."""
    left: list[Array] = [decision.vector()]
    return lambda obs: left.pop() if left else None
