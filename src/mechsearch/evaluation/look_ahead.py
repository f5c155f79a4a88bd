"""A ceiling: every teacher's push is tried in the simulator, and the best is carried out.

It needs snapshots of the simulator, which no robot has: it shows how well pushes can do. Its trial
actions are simulated, not executed, and are counted apart.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mechsearch.env.heap_env import HeapEnv
from mechsearch.env.trial import Rollout, imageless, roll_out
from mechsearch.pushes.push import spiral, straight, zigzag
from mechsearch.teachers import PushTeacher
from mechsearch.types import Observation

SHAPES = (straight, zigzag, spiral)
"""What is tried: pushes of the paper's three teachers."""

WITHOUT_SUCCESS = 100.0
"""What a trial that does not uncover the target is behind those that do."""


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


class LookAheadPolicy:
    """The best push found from an episode's start, executed to its end: the ceiling of pushes."""

    keys: tuple[str, ...] = ("ee_position",)

    def __init__(self, config: LookAheadConfig | None = None) -> None:
        """Set how far to look."""
        self._config = config or LookAheadConfig()
        self._env: HeapEnv | None = None
        self.simulated_actions = 0

    def reset(self, rng: np.random.Generator) -> None:
        """Forget the last plan; trials draw from the heap's own seed."""
        self._actions: list[NDArray[np.float32]] = []
        self.simulated_actions = 0

    def plan(self, env: HeapEnv) -> None:
        """Try every push from where the environment is, and keep the best to its end."""

        def score(rollout: Rollout) -> float:
            return rollout.reward - config.gentleness * rollout.clutter_moved

        def is_hopeless(rollout: Rollout) -> bool:
            return score(rollout) < best - config.margin

        if env is not self._env:
            self._env, self._twin = env, imageless(env)
        config, twin, snapshot = self._config, self._twin, env.snapshot()
        offset = twin.restore(snapshot)["target_offset"]
        towards = offset / max(float(np.linalg.norm(offset)), 1e-6)
        tried: list[tuple[float, NDArray[np.float32]]] = []
        best = -np.inf
        for i in range(config.directions):
            for shape in SHAPES:
                teacher = PushTeacher(shape, 2 * np.pi * i / config.directions)
                teacher.reset(np.random.default_rng([env.heap.seed, i]))
                rollout = roll_out(twin, twin.restore(snapshot), teacher.act, is_hopeless)
                # No success: a failed simulation must not be chosen for the penalties it escaped.
                behind = 0.0 if rollout.end == "uncovered" else WITHOUT_SUCCESS
                tried.append((score(rollout) - behind, np.array(rollout.actions, np.float32)))
                best = max(best, tried[-1][0])
        near = [actions for value, actions in tried if value >= best - config.tolerance]
        chosen = max(near, key=lambda actions: float(actions[0] @ towards))
        self._actions = list(chosen[::-1])
        self.simulated_actions = sum(len(actions) for _, actions in tried)

    def act(self, obs: Observation) -> NDArray[np.float32]:
        """Return the plan's next action (3,); stay in place once it is over."""
        return self._actions.pop() if self._actions else np.zeros(3, np.float32)
