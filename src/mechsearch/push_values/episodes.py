"""One episode of pushes: gone through in this process or another, and kept as a file."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from mechsearch.algorithm import at_least
from mechsearch.env import HeapEnv, Rollout, TaskConfig, from_start, imageless, roll_out, through
from mechsearch.files.tensors import Archive, load_archive, save_archive
from mechsearch.push_values.policy import PushPolicy, PushPolicyConfig
from mechsearch.push_values.value import PushOutcome, PushSamples, PushValueConfig
from mechsearch.pushes.push import PlannedPush, Push, Sight, look, view_pushes
from mechsearch.types import Array, MechSearchError

_EPISODE_KIND = "mechsearch pushes"


@dataclass(frozen=True)
class PushValuesConfig:
    """Learning what pushes bring, from episodes in which they are carried out.

    Attributes:
        networks: How many judge together.
        candidates: Random pushes to judge each time.
        tries: Pushes at each decision whose outcome is learnt from: the executed one, and others
            that are only tried in the simulator from there. Without a simulator it is 1.
        explore: Share of random pushes among the executed ones, after the first fit; before it, all
            are random.
        ranked: Share of the tried pushes that are the best of what the policy judges, not random.
        searches: Whether a hidden target is looked for all over the heap, and not only where it was
            seen last.
        full_steps: Whether pushes are carried out by actions of full length, which cut corners, and
            do not end at every waypoint.
        also: Sensors by which each decision is seen too, such as "stereo": what a push brought is
            learnt from these images as well. Without a simulator there are none.
        value: The network and its fit.
    """

    networks: int = 3
    candidates: int = PushPolicyConfig.candidates
    tries: int = 24
    explore: float = 0.1
    ranked: float = 0.5
    searches: bool = False
    full_steps: bool = False
    also: tuple[str, ...] = ()
    value: PushValueConfig = field(default_factory=PushValueConfig)

    def __post_init__(self) -> None:
        at_least(1, self, "networks", "candidates", "tries")
        if self.tries > self.candidates:
            raise MechSearchError(
                f"tries is {self.tries}, but {self.candidates} candidates are drawn; "
                f"expected 1 to {self.candidates}"
            )
        for name in self.also:
            TaskConfig(sensor=name)
        if not (0 <= self.explore <= 1 and 0 <= self.ranked <= 1):
            raise MechSearchError(
                f"explore is {self.explore} and ranked {self.ranked}; expected shares in [0, 1]"
            )


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


class Episodes:
    """Goes through episodes by number: each is the same in whichever process, and after any other.

    Attributes:
        env: The task, with images and privileged positions for the trials.
        policy: Who chooses pushes.
    """

    def __init__(
        self, config: PushValuesConfig, env: Any, heaps: Sequence[int], seed: int, threads: int
    ) -> None:
        """Take what all episodes have in common.

        Args:
            config: What is tried and explored.
            env: Whose heaps, objects and task are taken.
            heaps: Indices of those to learn on.
            seed: Of the run.
            threads: Of PyTorch; other numbers give other bits.

        Raises:
            MechSearchError: If the environment has no heaps.
        """
        if not isinstance(env, HeapEnv):
            raise MechSearchError(f"pushes are learnt in heaps, not in a {type(env).__name__}")
        self._config, self._heaps, self._seed, self._threads = config, heaps, seed, threads
        self.policy: PushPolicy | None = None
        self._open(env)

    def _open(self, env: HeapEnv) -> None:
        torch.set_num_threads(self._threads)
        self.env, self._twin = env, imageless(env)
        self.env.on_demand = True
        self._also = [through(env, sensor) for sensor in self._config.also]

    def __getstate__(self) -> dict[str, Any]:
        """Return what another process needs: a simulator it has to make itself."""
        parts = self.env.heaps, self.env.objects, self.env.config
        return {**vars(self), "env": parts, "_twin": None, "_also": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Make the simulators."""
        vars(self).update(state)
        self._open(HeapEnv(*state["env"]))

    def __call__(self, number: int) -> EpisodeOfPushes:
        """Go through one episode on a random heap."""
        assert self.policy is not None
        rng = np.random.default_rng([self._seed, number])
        heap, seed = int(rng.choice(self._heaps)), int(rng.integers(2**31))
        obs, _ = self.env.reset(seed=seed, options={"heap": heap})
        self.policy.reset(rng)
        samples, rollouts, count = [], [Rollout(obs)], 0
        while rollouts[-1].end is None:
            sight = self.policy.see(rollouts[-1].obs)
            pushes, snapshot = self._choose(sight, rng), self.env.snapshot()
            tried = self._try(snapshot, pushes[1:], sight)
            count += sum(len(rollout.actions) for rollout in tried)
            others = self._see_again(snapshot, number) if sight.target.any() else []
            push = self.policy.begin(pushes[0], sight)
            done = roll_out(self.env, rollouts[-1].obs, push.act)
            # A push whose way ends where the end effector is takes no action: choose another.
            rollouts += [done] if done.actions else []
            outcomes = [outcome_of(rollout) for rollout in (done, *tried)]
            samples += [_samples(pushes, sight, other, outcomes) for other in (sight, *others)]
        summary = _summary(heap, rollouts[1:], count)
        return EpisodeOfPushes(PushSamples.joined(samples), _followed(rollouts[1:]), summary)

    def _choose(self, sight: Sight, rng: np.random.Generator) -> list[Push]:
        """Return the push to execute, and then those to try beside it."""
        plan, policy = self._config, self.policy
        assert policy is not None
        pushes = policy.draw(sight, rng)
        explores = rng.random() < plan.explore
        if not policy.networks:
            return pushes[: plan.tries]
        order = [pushes[i] for i in np.argsort(-policy.judge(pushes, sight))]
        ranked = max(round(plan.ranked * plan.tries), 1)
        rest = order[ranked:]
        picks = rng.choice(len(rest), plan.tries - ranked, replace=False)
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
        return rollouts

    def _see_again(self, snapshot: dict[str, Array], number: int) -> list[Sight]:
        """Return a decision as the other sensors see it, where they see the target."""
        assert self.policy is not None
        episode = {"episode": np.array(number)}
        sights = [look(env.restore(snapshot | episode), self.policy.camera) for env in self._also]
        return [sight for sight in sights if sight.centre is not None]


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


def _samples(
    pushes: Sequence[Push], seen: Sight, sight: Sight, outcomes: Sequence[PushOutcome | None]
) -> PushSamples:
    """Return what is learnt of pushes, planned as it was seen, from how it is seen otherwise."""
    learnt = [(p, outcome) for p, outcome in zip(pushes, outcomes, strict=True) if outcome]
    if sight is not seen:
        assert sight.centre is not None
        assert seen.centre is not None
        learnt = [(push.about(sight.centre - seen.centre), outcome) for push, outcome in learnt]
    views = view_pushes([push for push, _ in learnt], sight)
    return PushSamples.of(views, [outcome for _, outcome in learnt])


def _followed(rollouts: Sequence[Rollout]) -> torch.Tensor:
    rewards = np.array([rollout.reward for rollout in rollouts])
    after = rewards[::-1].cumsum()[::-1] - rewards
    rows = [(c.occlusion, r) for c, r in zip(rollouts, after, strict=True) if c.end is None]
    return torch.tensor(rows, dtype=torch.float32).reshape(-1, 2)


def _summary(heap: int, rollouts: Sequence[Rollout], tried: int) -> dict[str, Any]:
    terms = {
        f"term_{name}": float(sum(rollout.terms[name] for rollout in rollouts))
        for name in rollouts[0].terms
    }
    return {
        "heap": heap,
        "end": rollouts[-1].end,
        "actions": sum(len(rollout.actions) for rollout in rollouts),
        "pushes": len(rollouts),
        "tried": tried,
        "return": sum(terms.values()),
        **terms,
    }


def save_episode(episode: EpisodeOfPushes, path: Path) -> None:
    """Write an episode, whole or not at all."""
    tensors = {**vars(episode.samples), "followed": episode.followed}
    save_archive(path, Archive(_EPISODE_KIND, tensors, {"summary": episode.summary}))


def load_episode(path: Path) -> EpisodeOfPushes:
    """Read an episode.

    Raises:
        MechSearchError: If the file is missing or damaged.
    """
    archive = load_archive(path, _EPISODE_KIND)
    tensors = dict(archive.tensors)
    followed = tensors.pop("followed")
    return EpisodeOfPushes(PushSamples(**tensors), followed, archive.meta["summary"])
