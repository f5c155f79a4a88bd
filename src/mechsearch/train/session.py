"""The learning side of a run: everything that changes while it goes on, except the world."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray

from mechsearch.agent.ddpg import Learner
from mechsearch.agent.exploration import Noise
from mechsearch.agent.guidance import Guidance
from mechsearch.agent.replay import Replay
from mechsearch.agent.weights import Archive, part, prefixed
from mechsearch.train.checkpoint import generator_state, restore_generator
from mechsearch.train.config import TrainConfig
from mechsearch.train.episode import EpisodeLog
from mechsearch.types import Array, MechSearchError, Observation, Policy, select

Env = gymnasium.Env[dict[str, Array], Array]
Evaluator = Callable[[Policy], Mapping[str, float]]


@dataclass(frozen=True)
class Parts:
    """What a run is given, ready-made.

    Attributes:
        env: The task, with privileged observations.
        heaps: Indices of the heaps to learn on.
        teachers: Who guides, by name.
        evaluators: Score a policy on heaps of their own, by name of these heaps.
    """

    env: Env
    heaps: Sequence[int]
    teachers: Mapping[str, Policy]
    evaluators: Mapping[str, Evaluator]


@dataclass(frozen=True)
class Decision:
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


class Session:
    """Learner, replay, guidance, generators and counters."""

    def __init__(self, config: TrainConfig, parts: Parts) -> None:
        """Build everything from the configuration and its seed.

        Raises:
            MechSearchError: If the environment lacks a key, or the replay does not fit.
        """
        self.config, self.parts = config, parts
        torch.set_num_threads(config.threads)
        torch.manual_seed(config.seed)
        spaces = _spaces(parts.env, config)
        shapes = {key: tuple(space.shape or ()) for key, space in spaces.items()}
        dtypes = {key: np.dtype(space.dtype) for key, space in spaces.items()}
        self.learner = Learner(
            {key: shapes[key] for key in config.actor_keys},
            {key: shapes[key] for key in config.critic_keys},
            config.learner,
            config.seed,
        )
        self.replay = Replay(shapes, dtypes, min(config.replay_rows, 2 * config.actions + 2))
        self.guidance = Guidance(config.guidance)
        self.noise = Noise(config.noise)
        seeds = np.random.SeedSequence(config.seed).spawn(3)
        names = ("episodes", "exploration", "batches")
        self.rngs = {n: np.random.default_rng(s) for n, s in zip(names, seeds, strict=True)}
        self.counts = {"step": 0, "episodes": 0, "updates": 0, "failures": 0}

    @property
    def step(self) -> int:
        """Actions executed so far."""
        return self.counts["step"]

    def begin(self) -> dict[str, Array]:
        """Begin an episode on a random heap; return its first observation."""
        rng = self.rngs["episodes"]
        heap = int(rng.choice(self.parts.heaps))
        env_seed, *seeds = (int(s) for s in rng.integers(2**31, size=1 + len(self.parts.teachers)))
        for teacher, seed in zip(self.parts.teachers.values(), seeds, strict=True):
            teacher.reset(np.random.default_rng(seed))
        self.guidance.reset()
        self.noise.reset()
        names = ("actor", *self.parts.teachers)
        self.episode = EpisodeLog(heap, names, self.config.learner.gamma)
        obs, _ = self.parts.env.reset(seed=env_seed, options={"heap": heap})
        return obs

    def decide(self, obs: Observation) -> Decision:
        """Let the actor and every teacher propose, and choose one (paper, III-C)."""
        rng = self.rngs["exploration"]
        own = self.learner.act(obs)
        proposals = [self.noise.added(own, rng)]
        proposals += [t.act(select(obs, t.keys)) for t in self.parts.teachers.values()]
        actions = np.stack(proposals).astype(np.float32)
        samples = self.learner.q_samples(obs, actions)
        choice = self.guidance.choose(samples, rng)
        return Decision(actions[choice], own, choice, float(samples[:, choice].mean()))

    def store(
        self,
        obs: Observation,
        decision: Decision,
        outcome: tuple[dict[str, Array], Any, bool, bool, dict[str, Any]],
    ) -> None:
        """Keep what an action led to; a failed simulation's transition is not kept."""
        after, reward, terminated, truncated, info = outcome
        reward = float(reward)
        self.counts["step"] += 1
        self.counts["episodes"] += terminated or truncated
        self.episode.add(decision.choice, decision.q, decision.actor_action, reward, info)
        if info.get("failure"):
            self.counts["failures"] += 1
            self.replay.end(obs)
            return
        discount = 0.0 if terminated else self.config.learner.gamma
        self.replay.add(obs, decision.action, reward, discount)
        if terminated or truncated:
            self.replay.end(after)

    def update(self) -> None:
        """Take the gradient steps that are due."""
        since = self.step - self.config.warmup
        if since <= 0 or not len(self.replay):
            return
        rate = self.config.updates_per_action
        for _ in range(int(since * rate) - int((since - 1) * rate)):
            self.episode.add_update(self.learner.update(self.replay, self.rngs["batches"]))
            self.counts["updates"] += 1

    def archive(self) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
        """Return tensors and facts that `restore` takes back, between two episodes."""
        stored = {key: torch.from_numpy(value) for key, value in self.replay.state().items()}
        tensors = {**prefixed("learner", self.learner.state()), **prefixed("replay", stored)}
        rngs = {name: generator_state(rng) for name, rng in self.rngs.items()}
        return tensors, {"counts": dict(self.counts), "generators": rngs}

    def restore(self, archive: Archive) -> None:
        """Go back to a checkpoint; the next episode begins there.

        Raises:
            MechSearchError: If it is of other networks or observations.
        """
        self.learner.restore(part(archive.tensors, "learner"))
        stored = part(archive.tensors, "replay")
        self.replay.restore({key: value.numpy() for key, value in stored.items()})
        self.counts = {**self.counts, **archive.meta["counts"]}
        for name, rng in self.rngs.items():
            restore_generator(rng, archive.meta["generators"][name])


def _spaces(env: Env, config: TrainConfig) -> dict[str, gymnasium.Space[Any]]:
    space = env.observation_space
    if not isinstance(space, gymnasium.spaces.Dict):
        raise MechSearchError(f"the environment observes {space}; expected a dictionary")
    keys = dict.fromkeys((*config.actor_keys, *config.critic_keys))
    missing = [key for key in keys if key not in space.spaces]
    if missing:
        raise MechSearchError(
            f"the environment does not show {', '.join(missing)}; it shows "
            f"{', '.join(space.spaces)}. The critic needs privileged=True."
        )
    return {key: space.spaces[key] for key in keys}
