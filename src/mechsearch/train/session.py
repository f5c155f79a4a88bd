"""The learning side of a run: everything that changes while it goes on, except the world."""

from typing import Any

import gymnasium
import numpy as np
import torch

from mechsearch.agent.behaviour import Behaviour
from mechsearch.agent.ddpg import Learner
from mechsearch.agent.replay import Replay
from mechsearch.agent.weights import Archive, part, prefixed
from mechsearch.train.checkpoint import generator_state, restore_generator
from mechsearch.train.collector import Collector, Env, Parts, Transition
from mechsearch.train.config import TrainConfig
from mechsearch.train.episode import EpisodeLog
from mechsearch.types import MechSearchError


class Session:
    """Learner, replay, collector, generators and counters."""

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
        seeds = np.random.SeedSequence(config.seed).spawn(3)
        names = ("episodes", "exploration", "batches")
        self.rngs = {n: np.random.default_rng(s) for n, s in zip(names, seeds, strict=True)}
        self.behaviour = Behaviour(self.learner, config.seed + 1)
        self.collector = Collector(config, parts, self.behaviour, self.rngs)
        self.episode: EpisodeLog | None = None
        self.counts = {"step": 0, "episodes": 0, "updates": 0, "failures": 0}

    @property
    def step(self) -> int:
        """Actions executed so far."""
        return self.counts["step"]

    def next_block(self) -> int:
        """Return how many actions to execute before the networks are looked at again."""
        config, step = self.config, self.step
        stop = min(config.actions, step - step % config.evaluate_every + config.evaluate_every)
        return min(config.block, stop - step)

    def store(self, done: Transition) -> dict[str, Any] | None:
        """Keep what an action led to; return the episode's summary if it is over.

        A failed simulation's transition is not kept.
        """
        self.counts["step"] += 1
        self.counts["episodes"] += done.over
        if self.episode is None:
            names = ("actor", *self.parts.teachers)
            self.episode = EpisodeLog(done.heap, names, self.config.learner.gamma)
        decision = done.decision
        self.episode.add(decision.choice, decision.q, decision.actor_action, done.reward, done.info)
        self._remember(done)
        if not done.over:
            return None
        # What is due for the episode belongs in its summary.
        self.update()
        episode, self.episode = self.episode, None
        return episode.summary(done.terminated, done.info)

    def _remember(self, done: Transition) -> None:
        if done.info.get("failure"):
            self.counts["failures"] += 1
            self.replay.end(done.obs)
            return
        discount = 0.0 if done.terminated else self.config.learner.gamma
        self.replay.add(done.obs, done.decision.action, done.reward, discount)
        if done.over:
            self.replay.end(done.after)

    def update(self) -> None:
        """Take the gradient steps that are due for all that is stored."""
        since = max(self.step - self.config.warmup, 0)
        due = int(since * self.config.updates_per_action)
        while self.counts["updates"] < due and len(self.replay):
            metrics = self.learner.update(self.replay, self.rngs["batches"])
            self.counts["updates"] += 1
            if self.episode is not None:
                self.episode.add_update(metrics)

    def archive(self) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
        """Return tensors and facts that `restore` takes back, between two episodes."""
        stored = {key: torch.from_numpy(value) for key, value in self.replay.state().items()}
        tensors = {**prefixed("learner", self.learner.state()), **prefixed("replay", stored)}
        tensors["behaviour"] = self.behaviour.generator.get_state()
        rngs = {name: generator_state(rng) for name, rng in self.rngs.items()}
        return tensors, {"counts": dict(self.counts), "generators": rngs}

    def restore(self, archive: Archive) -> None:
        """Go back to a checkpoint; the next episode begins there.

        Raises:
            MechSearchError: If it is of other networks or observations.
        """
        self.learner.restore(part(archive.tensors, "learner"))
        self.behaviour.generator.set_state(archive.tensors["behaviour"])
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
