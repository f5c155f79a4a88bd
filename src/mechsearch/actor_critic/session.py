"""All of a run that changes while it goes on."""

import json
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import gymnasium
import numpy as np
import torch

from mechsearch.actor_critic.behaviour import Behaviour
from mechsearch.actor_critic.collector import Collector, Env, Parts, Transition
from mechsearch.actor_critic.episode_log import EpisodeLog
from mechsearch.actor_critic.freed_memory import keep_freed_memory
from mechsearch.actor_critic.learner import Learner
from mechsearch.actor_critic.replay import Replay
from mechsearch.files.tensors import Archive, part, prefixed
from mechsearch.train.checkpoint import generator_state, restore_generator
from mechsearch.train.config import TrainConfig
from mechsearch.types import Array, MechSearchError


class Session:
    """Learner, replay, collector, generators and counters."""

    def __init__(self, config: TrainConfig, parts: Parts) -> None:
        """Build everything from the configuration and its seed.

        Raises:
            MechSearchError: If the environment lacks a key, or the replay does not fit.
        """
        self.config, self.parts = config, parts
        torch.set_num_threads(config.threads)
        keep_freed_memory()
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
        rows = min(config.replay_rows, 2 * config.actions + 2)
        self.replay = Replay(shapes, dtypes, rows, config.learner.worst)
        imitated = config.imitated or config.teachers
        # Candidate 0 is the actor.
        self._imitated = {1 + i for i, name in enumerate(parts.teachers) if name in imitated}
        seeds = np.random.SeedSequence(config.seed).spawn(3)
        names = ("episodes", "exploration", "batches")
        self.rngs = {n: np.random.default_rng(s) for n, s in zip(names, seeds, strict=True)}
        # It stays for the run: networks are slower in a thread's first calls.
        self._beside = ThreadPoolExecutor(1, thread_name_prefix="actor")
        self.behaviour = Behaviour(self.learner, config.seed + 1)
        self.collector = Collector(config, parts, self.behaviour, self.rngs)
        self.episode: EpisodeLog | None = None
        self.counts = {"step": 0, "block": 0, "episodes": 0, "updates": 0, "failures": 0}

    @property
    def step(self) -> int:
        """Actions executed so far."""
        return self.counts["step"]

    @property
    def begins_block(self) -> bool:
        """Whether to look at the networks: those that act stay the same within a block.

        Blocks end with episodes and before evaluations, wherever the run or a checkpoint does, so
        that a run which is cut off and goes on is the run that was never stopped.
        """
        return self.step == self.counts["block"]

    def next_actions(self) -> int:
        """Return how many actions to execute before something else is due."""
        config, step = self.config, self.step
        saving = step - step % config.checkpoint_every + config.checkpoint_every
        return min(self._block_end, saving, config.actions) - step

    @property
    def _block_end(self) -> int:
        began, every = self.counts["block"], self.config.evaluate_every
        return min(began + self.config.block, began - began % every + every)

    def store(self, done: Transition) -> dict[str, Any] | None:
        """Keep what an action led to; return the episode's summary if it is over.

        A failed simulation's transition is not kept.
        """
        self.counts["step"] += 1
        self.counts["episodes"] += done.over
        if self.episode is None:
            self.episode = self._new_log(done.heap)
        decision = done.decision
        self.episode.add(decision.choice, decision.q, decision.actor_action, done.reward, done.info)
        self._remember(done)
        if done.over or self.step == self._block_end:
            self.counts["block"] = self.step
        if not done.over:
            return None
        # What is due for the episode belongs in its summary.
        self.update()
        episode, self.episode = self.episode, None
        return episode.summary(done.terminated, done.info)

    def _remember(self, done: Transition) -> None:
        if done.info.get("failure"):
            self.counts["failures"] += 1
            self.replay.end(done.obs, whole=False)
            return
        discount = 0.0 if done.terminated else self.config.learner.gamma
        decision = done.decision
        imitated = decision.choice in self._imitated
        self.replay.add(done.obs, decision.action, done.reward, discount, imitated)
        if done.over:
            self.replay.end(done.after)

    def update(self) -> None:
        """Take the gradient steps that are due for all that is stored."""
        since = max(self.step - self.config.warmup, 0)
        due = int(since * self.config.updates_per_action)
        while self.counts["updates"] < due and len(self.replay):
            metrics = self.learner.update(self.replay, self.rngs["batches"], self._beside)
            self.counts["updates"] += 1
            if self.episode is not None:
                self.episode.add_update(metrics)

    def archive(self) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
        """Return tensors and facts that `restore` takes back, the running episode included."""
        arrays, episode = self.collector.archive()
        tensors = {
            **prefixed("learner", self.learner.state()),
            **prefixed("behaviour", self.behaviour.state()),
            **prefixed("replay", _tensors(self.replay.state())),
            **prefixed("episode", _tensors(arrays)),
        }
        return tensors, {
            "counts": dict(self.counts),
            "generators": {name: generator_state(rng) for name, rng in self.rngs.items()},
            "episode": episode,
            # As text, since the order of its names is the order in the log.
            "episode_log": None if self.episode is None else json.dumps(self.episode.state()),
        }

    def restore(self, archive: Archive) -> None:
        """Go back to a checkpoint, in the middle of an episode or between two.

        Raises:
            MechSearchError: If it is of other networks or observations.
        """
        tensors, meta = archive.tensors, archive.meta
        self.learner.restore(part(tensors, "learner"))
        self.behaviour.restore(part(tensors, "behaviour"))
        self.replay.restore(_arrays(part(tensors, "replay")))
        self.collector.restore(_arrays(part(tensors, "episode")), meta["episode"])
        self.counts = {**self.counts, **meta["counts"]}
        for name, rng in self.rngs.items():
            restore_generator(rng, meta["generators"][name])
        if meta["episode_log"] is not None:
            self.episode = self._new_log(meta["episode"]["heap"])
            self.episode.restore(json.loads(meta["episode_log"]))

    def _new_log(self, heap: int) -> EpisodeLog:
        return EpisodeLog(heap, ("actor", *self.parts.teachers), self.config.learner.gamma)


def _tensors(arrays: Mapping[str, Array]) -> dict[str, torch.Tensor]:
    return {name: torch.as_tensor(value) for name, value in arrays.items()}


def _arrays(tensors: Mapping[str, torch.Tensor]) -> dict[str, Array]:
    return {name: tensor.numpy() for name, tensor in tensors.items()}


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
