"""A ceiling: every teacher's push is tried in the simulator, and the best is carried out.

It needs snapshots of the simulator, which no robot has: it shows how well pushes can do. Its trial
actions are simulated, not executed, and are counted apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig
from mechsearch.heaps.heap import Heap
from mechsearch.objects.model import ObjectSet
from mechsearch.teachers import Teacher, make_teachers
from mechsearch.types import TEACHER_KEYS, Array, Observation, Policy, select


@dataclass(frozen=True)
class Plan:
    """The best push found.

    Attributes:
        actions: To the end of the episode (T, 3).
        simulated_actions: Actions tried, over all pushes.
    """

    actions: NDArray[np.float32]
    simulated_actions: int


WITHOUT_SUCCESS = 100.0
"""What a trial that does not uncover the target is behind those that do."""


@dataclass(frozen=True)
class Trial:
    """One push that was tried.

    Attributes:
        actions: As executed (T, 3).
        score: Reward less the cost of moving clutter; low without success.
        directness: Cosine between the first action and the way to the target.
    """

    actions: NDArray[np.float32]
    score: float
    directness: float


@dataclass(frozen=True)
class LookAheadConfig:
    """How far to look.

    Attributes:
        directions: Directions tried for each teacher.
        margin: A trial this far behind the best return so far is given up.
        gentleness: What each metre that the mean non-target object moves costs a trial, beyond
            its reward.
        tolerance: Of the trials this close to the best score, the one that sets out most directly
            for the target is taken.
    """

    directions: int = 8
    margin: float = 2.5
    gentleness: float = 50.0
    tolerance: float = 1.0


class LookAhead:
    """Plans from snapshots of an environment over the same heaps."""

    def __init__(
        self,
        heaps: Sequence[Heap],
        objects: ObjectSet,
        env: HeapEnvConfig,
        config: LookAheadConfig | None = None,
    ) -> None:
        """Prepare an imageless twin of the environment."""
        twin = replace(env, keys=TEACHER_KEYS, privileged=True)
        self._env = HeapEnv(heaps, objects, twin)
        self.config = config or LookAheadConfig()

    def plan(self, snapshot: dict[str, Array], seed: int) -> Plan:
        """Return the best push from a snapshot taken by `HeapEnv.snapshot`.

        Args:
            snapshot: Where to start; actions already taken count.
            seed: Of what teachers do after their first push.
        """
        trials: list[Trial] = []
        best = -np.inf
        for i in range(self.config.directions):
            direction = 2 * np.pi * i / self.config.directions
            for teacher in make_teachers(direction).values():
                teacher.reset(np.random.default_rng([seed, i]))
                trials.append(self._try(snapshot, teacher, best - self.config.margin))
                best = max(best, trials[-1].score)
        near = [trial for trial in trials if trial.score >= best - self.config.tolerance]
        chosen = max(near, key=lambda trial: trial.directness)
        return Plan(chosen.actions, sum(len(trial.actions) for trial in trials))

    def _try(self, snapshot: dict[str, Array], teacher: Teacher, give_up: float) -> Trial:
        """Execute one push in the simulator; one whose score falls below `give_up` is cut short."""
        obs = self._env.restore(snapshot)
        towards = obs["target_offset"] / max(float(np.linalg.norm(obs["target_offset"])), 1e-6)
        actions: list[NDArray[np.float32]] = []
        score = 0.0
        end: str | None = None
        while end is None:
            action = teacher.act(select(obs, teacher.keys))
            obs, reward, _, _, info = self._env.step(action)
            actions.append(action)
            score += reward - self.config.gentleness * info["clutter_moved"]
            end = "given up" if score < give_up else info["end"]
        if end != "uncovered":
            # No success: a failed simulation must not be chosen for the penalties it escaped.
            score -= WITHOUT_SUCCESS
        directness = float(actions[0] @ towards)
        return Trial(np.array(actions, np.float32), score, directness)


@runtime_checkable
class Planner(Policy, Protocol):
    """A policy that looks at the simulator itself before an episode begins."""

    simulated_actions: int
    """Actions simulated to plan the present episode, none of them executed."""

    def plan(self, env: HeapEnv) -> None:
        """Plan from where an environment is, and leave it there."""


class LookAheadPolicy:
    """The best push found from an episode's start, executed to its end: the ceiling of pushes."""

    keys: tuple[str, ...] = ("ee_position",)

    def __init__(self, config: LookAheadConfig | None = None) -> None:
        """Set how far to look."""
        self._config = config
        self._env: HeapEnv | None = None
        self.simulated_actions = 0

    def reset(self, rng: np.random.Generator) -> None:
        """Forget the last plan; trials draw from the heap's own seed."""
        self._actions: list[NDArray[np.float32]] = []
        self.simulated_actions = 0

    def plan(self, env: HeapEnv) -> None:
        """Try every push from where the environment is."""
        if env is not self._env:
            self._look_ahead = LookAhead(env.heaps, env.objects, env.config, self._config)
            self._env = env
        plan = self._look_ahead.plan(env.snapshot(), env.heap.seed)
        self._actions = list(plan.actions[::-1])
        self.simulated_actions = plan.simulated_actions

    def act(self, obs: Observation) -> NDArray[np.float32]:
        """Return the plan's next action (3,); stay in place once it is over."""
        return self._actions.pop() if self._actions else np.zeros(3, np.float32)
