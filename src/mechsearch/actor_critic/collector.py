"""Acts in the environment: actor and teachers propose, the critic chooses, the world answers."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mechsearch.actor_critic.behaviour import Behaviour
from mechsearch.actor_critic.exploration import Noise
from mechsearch.actor_critic.guidance import Guidance
from mechsearch.algorithm import TrainingSetup
from mechsearch.types import Array, Observation, select


@dataclass(frozen=True)
class ChosenAction:
    """What was decided in one observation.

    Attributes:
        action: To execute (3,), in [-1, 1].
        actor_action: What the actor would have done, without noise (3,).
        choice: Index of who acts; 0 is the actor.
        q: Expected Q of the action.
    """

    action: NDArray[np.float32]
    actor_action: NDArray[np.float32]
    choice: int
    q: float


@dataclass(frozen=True)
class Transition:
    """One executed action.

    Attributes:
        heap: Index of the heap.
        obs: Where it began.
        decision: What was done.
        after: Where it led.
        reward: What it earned.
        terminated: Whether the task ended with it.
        truncated: Whether the episode was cut off after it.
        info: What else the environment told.
    """

    heap: int
    obs: Observation
    decision: ChosenAction
    after: Observation
    reward: float
    terminated: bool
    truncated: bool
    info: dict[str, Any]

    @property
    def over(self) -> bool:
        """Whether the episode ended with it."""
        return self.terminated or self.truncated


class Collector:
    """Executes a run's actions. Between two calls nothing goes on."""

    def __init__(
        self,
        guidance: Guidance,
        noise: Noise,
        setup: TrainingSetup,
        behaviour: Behaviour,
        rngs: Mapping[str, np.random.Generator],
    ) -> None:
        """Take what acts.

        Args:
            guidance: The choice among actor and teachers.
            noise: Exploration of the actor.
            setup: Environment and teachers.
            behaviour: Copies of actor and critic.
            rngs: Generators of "episodes" and of "exploration".
        """
        self._setup = setup
        self._behaviour = behaviour
        self._rngs = rngs
        self._guidance, self._noise = guidance, noise
        self._heap = -1
        self._obs: Observation | None = None

    def collect(self, count: int) -> list[Transition]:
        """Execute `count` actions, or fewer up to the end of the episode."""
        done: list[Transition] = []
        while len(done) < count and not (done and done[-1].over):
            obs = self._begin() if self._obs is None else self._obs
            decision = self._decide(obs)
            after, reward, terminated, truncated, info = self._setup.env.step(decision.action)
            done.append(
                Transition(self._heap, obs, decision, after, reward, terminated, truncated, info)
            )
            self._obs = None if done[-1].over else after
        return done

    def archive(self) -> tuple[dict[str, Array], dict[str, Any] | None]:
        """Return the episode that goes on, as arrays and JSON, for `restore`; None between two."""
        if self._obs is None:
            return {}, None
        arrays = {f"env/{name}": value for name, value in self._setup.env.snapshot().items()}
        arrays |= {f"obs/{key}": value for key, value in self._obs.items()}
        teachers = {name: teacher.state() for name, teacher in self._setup.teachers.items()}
        return arrays, {
            "heap": self._heap,
            "guidance": self._guidance.state(),
            "noise": self._noise.state(),
            "teachers": teachers,
        }

    def restore(self, arrays: Mapping[str, Array], facts: Mapping[str, Any] | None) -> None:
        """Take back what `archive` returned."""
        if facts is None:
            return
        self._heap = facts["heap"]
        self._guidance.restore(facts["guidance"])
        self._noise.restore(facts["noise"])
        for name, teacher in self._setup.teachers.items():
            teacher.restore(facts["teachers"][name])
        kept: dict[str, dict[str, Array]] = {"env": {}, "obs": {}}
        for path, value in arrays.items():
            owner, _, name = path.partition("/")
            kept[owner][name] = value
        self._setup.env.restore(kept["env"])
        self._obs = kept["obs"]

    def _begin(self) -> Observation:
        """Begin an episode on a random heap; return its first observation."""
        rng, teachers = self._rngs["episodes"], self._setup.teachers.values()
        self._heap = int(rng.choice(self._setup.heaps))
        env_seed, *seeds = (int(s) for s in rng.integers(2**31, size=1 + len(teachers)))
        for teacher, seed in zip(teachers, seeds, strict=True):
            teacher.reset(np.random.default_rng(seed))
        self._guidance.reset()
        self._noise.reset()
        obs, _ = self._setup.env.reset(seed=env_seed, options={"heap": self._heap})
        return obs

    def _decide(self, obs: Observation) -> ChosenAction:
        """Let the actor and every teacher propose, and choose one (paper, III-C)."""
        rng = self._rngs["exploration"]
        own = self._behaviour.act(obs)
        proposals = [self._noise.added(own, rng)]
        proposals += [t.act(select(obs, t.keys)) for t in self._setup.teachers.values()]
        actions = np.stack(proposals).astype(np.float32)
        samples = self._behaviour.q_samples(obs, actions)
        choice = self._guidance.choose(samples, rng)
        return ChosenAction(actions[choice], own, choice, float(samples[:, choice].mean()))
