"""Learning what pushes bring: options, session, algorithm; `plus` is its name in the results."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import torch

from mechsearch.algorithm import Line, NamedTensors, RunConfig, TrainingSetup
from mechsearch.files import record_from_json
from mechsearch.files.tensors import filled, tensors_of
from mechsearch.push_values.episodes import (
    EpisodeOfPushes,
    Episodes,
    PushValuesConfig,
    load_episode,
    save_episode,
)
from mechsearch.push_values.policy import PushPolicy, PushPolicyConfig
from mechsearch.push_values.value import (
    Continuation,
    PushSamples,
    PushValue,
    PushValueConfig,
    fit_pushes,
)
from mechsearch.types import ACTOR_KEYS

EPISODES_FOLDER = "pushes"
"""Folder of a run directory with what its episodes taught."""

_RECENT, _ENOUGH = 300, 60
"""What follows a push is judged by so many of the last ones, once there are enough."""


class PushValuesSession:
    """Acts by pushes, remembers what they brought, and fits the networks to it."""

    def __init__(self, run: RunConfig[Any], setup: TrainingSetup, folder: Path) -> None:
        """Begin with random pushes.

        Args:
            run: The run.
            setup: The task, with images and privileged positions for the trials; no teachers.
            folder: The run directory, where episodes are kept.

        Raises:
            MechSearchError: If the environment has no heaps.
        """
        self.config: PushValuesConfig = run.algorithm
        self._run, self._folder, self._spread = run, folder / EPISODES_FOLDER, setup.spread
        self.episodes = Episodes(
            self.config, setup.env, setup.heaps, run.seed, run.schedule.threads
        )
        self.counts = {"executed": 0, "simulated": 0, "episodes": 0, "fits": 0}
        self._samples: list[PushSamples] = []
        self._followed: list[torch.Tensor] = []
        self._act((), Continuation())

    @property
    def policy(self) -> PushPolicy:
        """What has been learnt."""
        assert self.episodes.policy is not None
        return self.episodes.policy

    def _act(self, networks: Sequence[PushValue], continuation: Continuation) -> None:
        """Go on by other networks; whatever was played ahead by the old ones is left."""
        task, plan = self._run.task, self.config
        config = PushPolicyConfig(
            plan.candidates, task.camera, task.image_size, task.reward.idleness,
            plan.searches, plan.full_steps,
        )  # fmt: skip
        self.episodes.policy = PushPolicy(networks, continuation, config)
        self._played: Iterator[EpisodeOfPushes] | None = None

    @property
    def executed(self) -> int:
        """Actions executed so far."""
        return self.counts["executed"]

    def advance(self, until: int) -> Iterator[list[Line]]:
        """Go through an episode, and keep what it taught."""
        if self._played is None:
            self._played = self._spread(self.episodes, count(self.counts["episodes"]))
        episode = next(self._played)
        save_episode(episode, self._file(self.counts["episodes"]))
        self.remember(episode)
        self.counts["episodes"] += 1
        self.counts["executed"] += episode.summary["actions"]
        self.counts["simulated"] += episode.summary["tried"]
        # Episodes are noted under the round number of actions of the next fit.
        step = (self.counts["fits"] + 1) * self._run.schedule.evaluate_every
        yield [Line("episode", step, {"executed": self.executed, **episode.summary})]

    def catch_up(self, step: int) -> list[Line]:
        """Fit new networks to everything remembered."""
        return [Line("fit", step, self.fit())]

    def _file(self, episode: int) -> Path:
        return self._folder / f"{episode:06d}.safetensors"

    def remember(self, episode: EpisodeOfPushes) -> None:
        """Learn from an episode at the next fit."""
        self._samples.append(episode.samples)
        self._followed.append(episode.followed)

    def fit(self) -> dict[str, float]:
        """Fit new networks to everything remembered; return what the log notes."""
        plan, samples = self.config, PushSamples.joined(self._samples)
        continuation = _continuation(torch.cat(self._followed)[-_RECENT:])
        fit = _Fit(
            plan.value, samples, self._run.seed, self.counts["fits"], self._run.schedule.threads
        )
        self._played = None
        networks, losses = zip(*self._spread(fit, range(plan.networks)), strict=True)
        self.counts["fits"] += 1
        self._act(networks, continuation)
        return {
            "loss": float(np.mean(losses)),
            "pushes": len(samples),
            **asdict(continuation),
            **self.counts,
        }

    def archive(self) -> tuple[NamedTensors, dict[str, Any]]:
        """Return tensors and facts that `restore` takes back, between two episodes."""
        return tensors_of(self.policy.networks), {
            "counts": dict(self.counts),
            "ahead": asdict(self.policy.continuation),
        }

    def restore(self, tensors: NamedTensors, facts: Mapping[str, Any]) -> None:
        """Go back to where `archive` was called; the episodes until then are read again.

        Raises:
            MechSearchError: If a file is missing or damaged, or of other networks.
        """
        self.counts = {**self.counts, **facts["counts"]}
        fitted = self.config.networks if self.counts["fits"] else 0
        networks = filled([PushValue(self.config.value) for _ in range(fitted)], tensors)
        self._act(networks, record_from_json(Continuation, facts["ahead"]))
        for number in range(self.counts["episodes"]):
            self.remember(load_episode(self._file(number)))


@dataclass(frozen=True)
class _Fit:
    """Fits networks to samples, each by its number, in whichever process."""

    config: PushValueConfig
    samples: PushSamples
    seed: int
    fits: int
    threads: int

    def __call__(self, number: int) -> tuple[PushValue, float]:
        torch.set_num_threads(self.threads)
        source = np.random.SeedSequence([self.seed, self.fits, number])
        seed = int(source.generate_state(1)[0])
        torch.manual_seed(seed)
        network = PushValue(self.config)
        return network, fit_pushes(network, self.samples, seed)


def _continuation(followed: torch.Tensor) -> Continuation:
    """Return the line through what followed pushes that left the target covered."""
    if len(followed) < _ENOUGH:
        return Continuation()
    occlusion, rewards = followed.double().numpy().T
    slope, at_once = np.polyfit(occlusion, rewards, 1)
    return Continuation(float(at_once), float(max(-slope, 0.0)))


@dataclass(frozen=True)
class PushValues(PushValuesConfig):
    """Learning of whole pushes; its options are those of the configuration."""

    @property
    def keys(self) -> tuple[str, ...]:
        """What the actor of the paper sees."""
        return ACTOR_KEYS

    @property
    def teachers(self) -> tuple[str, ...]:
        """None: it needs no demonstrations."""
        return ()

    def check(self, task: Any) -> None:
        """Take any task: pushes are seen in their own frame, under any camera."""

    def begin(
        self, run: RunConfig["PushValues"], setup: TrainingSetup, folder: Path
    ) -> PushValuesSession:
        """Return a session at its beginning.

        Raises:
            MechSearchError: If the environment has no heaps.
        """
        return PushValuesSession(run, setup, folder)

    def save(self, policy: PushPolicy) -> tuple[NamedTensors, dict[str, Any]]:
        """Return the networks' weights, and all that choosing by them needs."""
        return tensors_of(policy.networks), {
            "network": asdict(policy.networks[0].config),
            "networks": len(policy.networks),
            "ahead": asdict(policy.continuation),
            "policy": asdict(policy.config),
        }

    def load(self, tensors: NamedTensors, facts: Mapping[str, Any]) -> PushPolicy:
        """Return the policy that `save` was given."""
        # Earlier versions kept the cost of an action with the network.
        network = dict(facts["network"])
        own = {"idleness": network.pop("idleness")} if "idleness" in network else {}
        config = record_from_json(PushValueConfig, network)
        return PushPolicy(
            filled([PushValue(config) for _ in range(int(facts["networks"]))], tensors),
            record_from_json(Continuation, facts["ahead"]),
            record_from_json(PushPolicyConfig, {**own, **facts["policy"]}),
        )
