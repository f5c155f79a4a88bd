"""Learning what pushes bring: options, session, algorithm; `plus` is its name in the results."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from mechsearch.algorithm import Line, NamedTensors, RunConfig, TrainingSetup, at_least
from mechsearch.env import (
    HeapEnv,
    Rollout,
    TaskConfig,
    from_start,
    imageless,
    roll_out,
    through,
)
from mechsearch.files import record_from_json
from mechsearch.files.tensors import Archive, filled, load_archive, save_archive, tensors_of
from mechsearch.observe.sensor import sensor_named
from mechsearch.push_values.policy import PushPolicy, PushPolicyConfig
from mechsearch.push_values.value import (
    Continuation,
    PushOutcome,
    PushSamples,
    PushValue,
    PushValueConfig,
    fit_pushes,
)
from mechsearch.pushes.push import PlannedPush, Push, Sight, look, view_pushes
from mechsearch.types import ACTOR_KEYS, Array, MechSearchError

EPISODES_FOLDER = "pushes"
"""Folder of a run directory with what its episodes taught."""

_EPISODE_KIND = "mechsearch pushes"

_RECENT, _ENOUGH = 300, 60
"""What follows a push is judged by so many of the last ones, once there are enough."""


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
            sensor_named(name)
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
        if not isinstance(setup.env, HeapEnv):
            raise MechSearchError(
                f"pushes are learnt in heaps, not in a {type(setup.env).__name__}"
            )
        torch.set_num_threads(run.schedule.threads)
        self.config: PushValuesConfig = run.algorithm
        self._run, self._folder = run, folder / EPISODES_FOLDER
        self._env, self._heaps = setup.env, setup.heaps
        self._twin = imageless(self._env)
        self._also = [through(self._env, sensor) for sensor in self.config.also]
        self.counts = {"executed": 0, "simulated": 0, "episodes": 0, "fits": 0}
        self._rng = np.random.default_rng(run.seed)
        self._samples: list[PushSamples] = []
        self._followed: list[torch.Tensor] = []
        self.policy = self._policy((), Continuation())

    def _policy(self, networks: Sequence[PushValue], continuation: Continuation) -> PushPolicy:
        task = self._run.task
        config = PushPolicyConfig(
            self.config.candidates, task.camera, task.image_size, task.reward.idleness,
            self.config.searches, self.config.full_steps,
        )  # fmt: skip
        return PushPolicy(networks, continuation, config)

    @property
    def executed(self) -> int:
        """Actions executed so far."""
        return self.counts["executed"]

    def advance(self, until: int) -> Iterator[list[Line]]:
        """Go through an episode, and keep what it taught."""
        episode = self.episode()
        save_episode(episode, self._file(self.counts["episodes"] - 1))
        self.remember(episode)
        # Episodes are noted under the round number of actions of the next fit.
        step = (self.counts["fits"] + 1) * self._run.schedule.evaluate_every
        yield [Line("episode", step, {"executed": self.executed, **episode.summary})]

    def catch_up(self, step: int) -> list[Line]:
        """Fit new networks to everything remembered."""
        return [Line("fit", step, self.fit())]

    def _file(self, episode: int) -> Path:
        return self._folder / f"{episode:06d}.safetensors"

    def episode(self) -> EpisodeOfPushes:
        """Go through one episode on a random heap."""
        heap, seed = int(self._rng.choice(self._heaps)), int(self._rng.integers(2**31))
        obs, _ = self._env.reset(seed=seed, options={"heap": heap})
        self.policy.reset(self._rng)
        samples, rollouts = [], [Rollout(obs)]
        while rollouts[-1].end is None:
            sight = self.policy.see(rollouts[-1].obs)
            pushes, snapshot = self._choose(sight), self._env.snapshot()
            tried = self._try(snapshot, pushes[1:], sight)
            others = self._see_again(snapshot) if sight.target.any() else []
            push = self.policy.begin(pushes[0], sight)
            rollouts.append(roll_out(self._env, rollouts[-1].obs, push.act))
            outcomes = [outcome_of(rollout) for rollout in (rollouts[-1], *tried)]
            samples += [_samples(pushes, sight, other, outcomes) for other in (sight, *others)]
            self.counts["executed"] += len(rollouts[-1].actions)
        self.counts["episodes"] += 1
        return EpisodeOfPushes(
            PushSamples.joined(samples), _followed(rollouts[1:]), _summary(heap, rollouts[1:])
        )

    def _choose(self, sight: Sight) -> list[Push]:
        """Return the push to execute, and then those to try beside it."""
        plan = self.config
        pushes = self.policy.draw(sight, self._rng)
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

    def _see_again(self, snapshot: dict[str, Array]) -> list[Sight]:
        """Return a decision as the other sensors see it, where they see the target."""
        number = {"episode": np.array(self.counts["episodes"])}
        sights = [look(env.restore(snapshot | number), self.policy.camera) for env in self._also]
        return [sight for sight in sights if sight.centre is not None]

    def remember(self, episode: EpisodeOfPushes) -> None:
        """Learn from an episode at the next fit."""
        self._samples.append(episode.samples)
        self._followed.append(episode.followed)

    def fit(self) -> dict[str, float]:
        """Fit new networks to everything remembered; return what the log notes."""
        plan, samples = self.config, PushSamples.joined(self._samples)
        continuation = _continuation(torch.cat(self._followed)[-_RECENT:])
        networks, losses = [], []
        for i in range(plan.networks):
            source = np.random.SeedSequence([self._run.seed, self.counts["fits"], i])
            seed = int(source.generate_state(1)[0])
            torch.manual_seed(seed)
            networks.append(PushValue(plan.value))
            losses.append(fit_pushes(networks[-1], samples, seed))
        self.counts["fits"] += 1
        self.policy = self._policy(networks, continuation)
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
            "generator": json.dumps(self._rng.bit_generator.state),
            "ahead": asdict(self.policy.continuation),
        }

    def restore(self, tensors: NamedTensors, facts: Mapping[str, Any]) -> None:
        """Go back to where `archive` was called; the episodes until then are read again.

        Raises:
            MechSearchError: If a file is missing or damaged, or of other networks.
        """
        self.counts = {**self.counts, **facts["counts"]}
        self._rng.bit_generator.state = json.loads(facts["generator"])
        count = self.config.networks if self.counts["fits"] else 0
        networks = filled([PushValue(self.config.value) for _ in range(count)], tensors)
        self.policy = self._policy(networks, record_from_json(Continuation, facts["ahead"]))
        for number in range(self.counts["episodes"]):
            self.remember(load_episode(self._file(number)))


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


def _continuation(followed: torch.Tensor) -> Continuation:
    """Return the line through what followed pushes that left the target covered."""
    if len(followed) < _ENOUGH:
        return Continuation()
    occlusion, rewards = followed.double().numpy().T
    slope, at_once = np.polyfit(occlusion, rewards, 1)
    return Continuation(float(at_once), float(max(-slope, 0.0)))


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

    def check(self, task: TaskConfig) -> None:
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
