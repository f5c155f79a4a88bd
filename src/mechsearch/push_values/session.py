"""The state of a run that learns pushes: its samples, its policy, its generators and counters."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from mechsearch.env.heap_env import HeapEnv
from mechsearch.env.trial import Rollout, from_start, imageless, roll_out
from mechsearch.files import record_from_json
from mechsearch.files.tensors import Archive, load_archive, save_archive
from mechsearch.push_values.policy import PushPolicy
from mechsearch.push_values.value import (
    Ahead,
    PushOutcome,
    PushSamples,
    PushValue,
    fit,
    networks_of,
    tensors_of,
)
from mechsearch.pushes import PlannedPush, Push, Sight, draw_pushes, view_pushes
from mechsearch.train.checkpoint import generator_state, restore_generator
from mechsearch.train.config import TrainConfig
from mechsearch.types import Array

KIND = "mechsearch pushes"

_RECENT, _ENOUGH = 300, 60
"""What follows a push is judged by so many of the last ones, once there are enough."""


@dataclass(frozen=True)
class EpisodeOfPushes:
    """What one episode taught.

    Attributes:
        samples: All pushes whose outcome was seen.
        followed: For each executed push that did not end the episode, the occlusion that it left
            and the rewards that followed (M, 2).
        summary: The episode's line in the log.
    """

    samples: PushSamples
    followed: torch.Tensor
    summary: dict[str, Any]


class PushSession:
    """Acts by pushes, remembers what they brought, and fits the networks to it."""

    def __init__(self, config: TrainConfig, env: HeapEnv, heaps: Sequence[int]) -> None:
        """Begin with random pushes.

        Args:
            config: The run.
            env: The task, with images and privileged positions for the trials.
            heaps: Indices of the heaps to learn on.
        """
        torch.set_num_threads(config.threads)
        self.config, self._env, self._heaps = config, env, heaps
        self._twin = imageless(env)
        self.counts = {"executed": 0, "simulated": 0, "episodes": 0, "fits": 0}
        self._rng = np.random.default_rng(config.seed)
        self._samples: list[PushSamples] = []
        self._followed: list[torch.Tensor] = []
        self.policy = self._policy((), Ahead())

    def _policy(self, networks: Sequence[PushValue], ahead: Ahead) -> PushPolicy:
        camera, size = self.config.camera, self.config.image_size
        config = replace(self.config.pushes.policy, camera=camera, image_size=size)
        return PushPolicy(networks, ahead, config, self.counts["executed"])

    def episode(self) -> EpisodeOfPushes:
        """Go through one episode on a random heap."""
        heap, seed = int(self._rng.choice(self._heaps)), int(self._rng.integers(2**31))
        obs, _ = self._env.reset(seed=seed, options={"heap": heap})
        self.policy.reset(self._rng)
        samples, rollouts = [], [Rollout(obs)]
        while rollouts[-1].end is None:
            sight = self.policy.see(rollouts[-1].obs)
            pushes = self._choose(sight)
            tried = self._try(self._env.snapshot(), pushes[1:], sight)
            push = PlannedPush(pushes[0], sight)
            rollouts.append(roll_out(self._env, rollouts[-1].obs, push.act))
            samples.append(_samples(pushes, sight, [rollouts[-1], *tried]))
            self.counts["executed"] += len(rollouts[-1].actions)
        self.counts["episodes"] += 1
        return EpisodeOfPushes(
            PushSamples.joined(samples), _followed(rollouts[1:]), _summary(heap, rollouts[1:])
        )

    def _choose(self, sight: Sight) -> list[Push]:
        """Return the push to execute, and then those to try beside it."""
        plan = self.config.pushes
        pushes = draw_pushes(plan.policy.candidates, self._rng)
        explores = self._rng.random() < plan.explore
        if not self.policy.networks:
            return pushes[: plan.tries]
        order = [pushes[i] for i in np.argsort(-self.policy.judge(pushes, sight))]
        ranked = max(round(plan.ranked * plan.tries), 1)
        rest = order[ranked:]
        picks = self._rng.choice(len(rest), plan.tries - ranked, replace=False)
        tried = [*order[:ranked], *(rest[i] for i in picks)]
        if explores:
            return tried[::-1] if len(picks) else pushes[: plan.tries]
        return tried

    def _try(
        self, snapshot: dict[str, Array], pushes: Sequence[Push], sight: Sight
    ) -> list[Rollout]:
        rollouts = []
        for push in pushes:
            obs = self._twin.restore(from_start(snapshot))
            rollouts.append(roll_out(self._twin, obs, PlannedPush(push, sight).act))
        self.counts["simulated"] += sum(len(rollout.actions) for rollout in rollouts)
        return rollouts

    def remember(self, episode: EpisodeOfPushes) -> None:
        """Learn from an episode at the next fit."""
        self._samples.append(episode.samples)
        self._followed.append(episode.followed)

    def fit(self) -> dict[str, float]:
        """Fit new networks to everything remembered; return what the log notes."""
        plan, samples = self.config.pushes, PushSamples.joined(self._samples)
        ahead = _ahead(torch.cat(self._followed)[-_RECENT:])
        networks, losses = [], []
        for i in range(plan.networks):
            source = np.random.SeedSequence([self.config.seed, self.counts["fits"], i])
            seed = int(source.generate_state(1)[0])
            torch.manual_seed(seed)
            networks.append(PushValue(plan.value))
            losses.append(fit(networks[-1], samples, seed))
        self.counts["fits"] += 1
        self.policy = self._policy(networks, ahead)
        return {
            "loss": float(np.mean(losses)),
            "pushes": len(samples),
            **asdict(ahead),
            **self.counts,
        }

    def archive(self) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
        """Return tensors and facts that `restore` takes back, between two episodes."""
        return tensors_of(self.policy.networks), {
            "counts": dict(self.counts),
            "generator": generator_state(self._rng),
            "ahead": asdict(self.policy.ahead),
        }

    def restore(self, archive: Archive, episodes: Sequence[EpisodeOfPushes]) -> None:
        """Go back to a checkpoint, after these episodes."""
        self.counts = {**self.counts, **archive.meta["counts"]}
        restore_generator(self._rng, archive.meta["generator"])
        plan = self.config.pushes
        networks = networks_of(archive.tensors, plan.networks, plan.value)
        self.policy = self._policy(networks, record_from_json(Ahead, archive.meta["ahead"]))
        for episode in episodes:
            self.remember(episode)


def outcome_of(rollout: Rollout) -> PushOutcome | None:
    """Return what is learnt from a push; nothing where it was cut off or the simulator failed."""
    if not rollout.actions or rollout.end not in (None, "uncovered", "lost"):
        return None
    return PushOutcome(
        rollout.reward - rollout.terms["idleness"],
        len(rollout.actions),
        rollout.end == "uncovered",
        min(rollout.occlusion, 1.0),
        rollout.clutter_moved,
    )


def _samples(pushes: Sequence[Push], sight: Sight, rollouts: Sequence[Rollout]) -> PushSamples:
    learnt: list[tuple[Push, PushOutcome]] = []
    for push, rollout in zip(pushes, rollouts, strict=True):
        outcome = outcome_of(rollout)
        if outcome is not None:
            learnt.append((push, outcome))
    views = view_pushes([push for push, _ in learnt], sight)
    return PushSamples.of(views, [outcome for _, outcome in learnt])


def _followed(rollouts: Sequence[Rollout]) -> torch.Tensor:
    rewards = np.array([rollout.reward for rollout in rollouts])
    after = rewards[::-1].cumsum()[::-1] - rewards
    rows = [(c.occlusion, r) for c, r in zip(rollouts, after, strict=True) if c.end is None]
    return torch.tensor(rows, dtype=torch.float32).reshape(-1, 2)


def _ahead(followed: torch.Tensor) -> Ahead:
    """Return the line through what followed pushes that left the target covered."""
    if len(followed) < _ENOUGH:
        return Ahead()
    occlusion, rewards = followed.double().numpy().T
    slope, at_once = np.polyfit(occlusion, rewards, 1)
    return Ahead(float(at_once), float(max(-slope, 0.0)))


def _summary(heap: int, rollouts: Sequence[Rollout]) -> dict[str, Any]:
    terms = {
        f"term_{name}": float(sum(rollout.terms[name] for rollout in rollouts))
        for name in rollouts[0].terms
    }
    return {
        "heap": heap,
        "end": rollouts[-1].end,
        "actions": sum(len(rollout.actions) for rollout in rollouts),
        "pushes": len(rollouts),
        "return": sum(terms.values()),
        **terms,
    }


def save_episode(episode: EpisodeOfPushes, path: Path) -> None:
    """Write an episode, whole or not at all."""
    tensors = {**vars(episode.samples), "followed": episode.followed}
    save_archive(path, Archive(KIND, tensors, {"summary": episode.summary}))


def load_episode(path: Path) -> EpisodeOfPushes:
    """Read an episode.

    Raises:
        MechSearchError: If the file is missing or damaged.
    """
    archive = load_archive(path, KIND)
    tensors = dict(archive.tensors)
    followed = tensors.pop("followed")
    return EpisodeOfPushes(PushSamples(**tensors), followed, archive.meta["summary"])
