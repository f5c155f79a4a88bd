"""Carries out pushes in an environment, and records what they brought."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mechsearch.env.heap_env import HeapEnv
from mechsearch.push_values.value import PushOutcome
from mechsearch.pushes import Push, PushFollower, Sight
from mechsearch.types import TEACHER_KEYS, Array, Observation


@dataclass
class Course:
    """How a push went.

    Attributes:
        obs: The last observation.
        actions: How many it took.
        reward: Sum of all terms.
        terms: Each term's sum.
        clutter_moved: Sum over the actions of the mean non-target displacement [m].
        end: How the episode ended with it, or None.
        occlusion: Of the target afterwards.
    """

    obs: Observation
    actions: int = 0
    reward: float = 0.0
    terms: dict[str, float] = field(default_factory=dict)
    clutter_moved: float = 0.0
    end: str | None = None
    occlusion: float = 1.0

    def add(self, obs: Observation, reward: float, info: dict[str, Any]) -> None:
        """Note one action."""
        self.obs, self.end, self.occlusion = obs, info["end"], float(info["occlusion"])
        self.actions += 1
        self.reward += reward
        self.clutter_moved += info["clutter_moved"]
        for name, value in info["reward_terms"].items():
            self.terms[name] = self.terms.get(name, 0.0) + value

    @property
    def outcome(self) -> PushOutcome | None:
        """What is learnt from it; nothing where the episode was cut off or the simulator failed."""
        if not self.actions or self.end not in (None, "uncovered", "lost"):
            return None
        return PushOutcome(
            self.reward - self.terms["idleness"],
            self.actions,
            self.end == "uncovered",
            min(self.occlusion, 1.0),
            self.clutter_moved,
        )


def carry_out(env: HeapEnv, obs: Observation, push: Push, sight: Sight) -> Course:
    """Carry out a push to its end, or to the episode's.

    Args:
        env: Where.
        obs: Its present observation; "ee_position" is read.
        push: What to do.
        sight: What was seen before.
    """
    follower, course = PushFollower(push, sight), Course(obs)
    while course.end is None:
        action = follower.next(course.obs["ee_position"])
        if action is None:
            break
        after, reward, _, _, info = env.step(action)
        course.add(after, float(reward), info)
    return course


class Trials:
    """Tries pushes in an imageless twin of an environment."""

    def __init__(self, env: HeapEnv) -> None:
        self._twin = HeapEnv(
            env.heaps, env.objects, replace(env.config, keys=TEACHER_KEYS, privileged=True)
        )

    def attempt(self, snapshot: dict[str, Array], push: Push, sight: Sight) -> Course:
        """Carry out a push from a snapshot of the environment, as if the episode began there."""
        fresh = snapshot | {"actions": np.zeros_like(snapshot["actions"])}
        return carry_out(self._twin, self._twin.restore(fresh), push, sight)
