"""An expert that tries every teacher's push in the simulator and keeps the best.

It needs snapshots, so it is no policy: it shows how well pushes can do, and what to imitate. Its
trial actions are simulated, not executed, and are counted apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig
from mechsearch.heaps.heap import Heap
from mechsearch.objects.model import ObjectSet
from mechsearch.teachers import Teacher, make_teachers
from mechsearch.types import TEACHER_KEYS, Array, select


@dataclass(frozen=True)
class Plan:
    """The best push found.

    Attributes:
        actions: To the end of the episode (T, 3).
        reward: Sum of rewards that they earned in the trial.
        end: How the episode ended in the trial.
        teacher: Whose push it is.
        direction: Of its first push [rad].
        simulated_actions: Actions tried, over all pushes.
    """

    actions: NDArray[np.float32]
    reward: float
    end: str
    teacher: str
    direction: float
    simulated_actions: int


@dataclass(frozen=True)
class LookAheadConfig:
    """How far to look.

    Attributes:
        directions: Directions tried for each teacher.
        margin: A trial this far behind the best return so far is given up.
    """

    directions: int = 8
    margin: float = 2.5


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
        best: Plan | None = None
        tried = 0
        for i in range(self.config.directions):
            direction = 2 * np.pi * i / self.config.directions
            for name, teacher in make_teachers(direction).items():
                teacher.reset(np.random.default_rng([seed, i]))
                floor = -np.inf if best is None else best.reward
                trial = self._try(snapshot, teacher, floor - self.config.margin, floor)
                tried += len(trial[0])
                if best is None or trial[1] > best.reward:
                    best = Plan(*trial, name, direction, 0)
        assert best is not None
        return replace(best, simulated_actions=tried)

    def _try(
        self, snapshot: dict[str, Array], teacher: Teacher, give_up: float, floor: float
    ) -> tuple[NDArray[np.float32], float, str]:
        """Return actions, return and end of one push; one that is given up earns less than best."""
        obs = self._env.restore(snapshot)
        actions: list[NDArray[np.float32]] = []
        total = 0.0
        while True:
            action = teacher.act(select(obs, teacher.keys))
            obs, reward, terminated, truncated, info = self._env.step(action)
            actions.append(action)
            total += reward
            if terminated or truncated:
                # A failed simulation must not be chosen for the penalties it escaped.
                failed = info["failure"] is not None or info["end"] == "lost"
                earned = min(total, -100.0) if failed else total
                return np.array(actions, np.float32), earned, str(info["end"])
            if total < give_up:
                return np.array(actions, np.float32), min(total, floor), "given up"
