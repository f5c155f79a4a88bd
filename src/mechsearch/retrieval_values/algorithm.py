"""Learning to retrieve: options, session and algorithm; `retrieve` is its name in the results."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from mechsearch.algorithm import Line, NamedTensors, RunConfig, TrainingSetup, at_least
from mechsearch.env import (
    Decision,
    Propose,
    RetrievalTask,
    RetrieveEnv,
    TaskConfig,
    from_start,
    imageless,
    once,
    pushing,
    roll_out,
)
from mechsearch.files import record_from_json
from mechsearch.files.tensors import Archive, filled, load_archive, save_archive, tensors_of
from mechsearch.retrieval.grasper import Candidate, Grasper
from mechsearch.retrieval_values.policy import RetrievePolicy, RetrievePolicyConfig
from mechsearch.retrieval_values.value import (
    OptionSamples,
    RetrievalValue,
    RetrievalValueConfig,
    fit_options,
)
from mechsearch.retrieval_values.view import Option, PushOption, RemovalOption, view_options
from mechsearch.types import GRASP_KEYS, RETRIEVAL_KEYS, Array, MechSearchError, Observation

OPTIONS_FOLDER = "options"
"""Folder of a run directory with what its episodes taught."""

_OPTIONS_KIND = "mechsearch options"

_LABEL_PROPOSALS = 60
"""Grasps rated after an option, for its label."""


@dataclass(frozen=True)
class RetrievalValuesConfig:
    """Learning what pushes and removals make of the chance to grasp the target.

    Attributes:
        networks: How many judge together.
        tries: Pushes at each decision that are tried in the simulator; removals all are.
        explore: Share of decisions at random, after the first fit; before it, all are.
        ranked: Share of the tried pushes that are the best of what the policy judges, not random.
        value: The network and its fit.
        policy: How decisions are made; its view is the task's.
    """

    networks: int = 3
    tries: int = 8
    explore: float = 0.25
    ranked: float = 0.4
    value: RetrievalValueConfig = field(default_factory=RetrievalValueConfig)
    policy: RetrievePolicyConfig = field(default_factory=RetrievePolicyConfig)

    def __post_init__(self) -> None:
        at_least(1, self, "networks", "tries")
        if self.tries > self.policy.pushes:
            raise MechSearchError(
                f"tries is {self.tries}, but {self.policy.pushes} pushes are drawn; expected 1 to "
                f"{self.policy.pushes}"
            )
        if not (0 <= self.explore <= 1 and 0 <= self.ranked <= 1):
            raise MechSearchError(
                f"explore is {self.explore} and ranked {self.ranked}; expected shares in [0, 1]"
            )


class RetrievalValuesSession:
    """Decides, tries what else could be done, and fits the networks to what that came to."""

    def __init__(self, run: RunConfig[Any], setup: TrainingSetup, folder: Path) -> None:
        """Begin with random decisions.

        Args:
            run: The run.
            setup: The task; no teachers.
            folder: The run directory, where episodes are kept.

        Raises:
            MechSearchError: If the task is no retrieval.
        """
        if not isinstance(setup.env, RetrieveEnv):
            raise MechSearchError(
                f"retrieval is learnt in a RetrieveEnv, not in a {type(setup.env).__name__}"
            )
        torch.set_num_threads(run.schedule.threads)
        self.config: RetrievalValuesConfig = run.algorithm
        self._run, self._folder = run, folder / OPTIONS_FOLDER
        self._env, self._heaps = setup.env, setup.heaps
        self._twin = imageless(self._env)
        shown = replace(self._env.config, keys=GRASP_KEYS, privileged=False)
        self._eyes = RetrieveEnv(self._env.heaps, self._env.objects, shown)
        self._rater = Grasper(_LABEL_PROPOSALS)
        self._rater.equip(self._env.config.grippers)
        self.counts = {"executed": 0, "simulated": 0, "episodes": 0, "fits": 0}
        self._rng = np.random.default_rng(run.seed)
        self._samples: list[OptionSamples] = []
        self.policy = self._policy(())

    def _policy(self, networks: Sequence[RetrievalValue]) -> RetrievePolicy:
        task = self._run.task
        config = replace(self.config.policy, camera=task.camera, image_size=task.image_size)
        policy = RetrievePolicy(networks, config)
        policy.equip(self._env.config.grippers)
        return policy

    @property
    def executed(self) -> int:
        """Actions executed so far: push actions, grasps and removals."""
        return self.counts["executed"]

    def advance(self, until: int) -> Iterator[list[Line]]:
        """Go through an episode, and keep what it taught."""
        samples, summary = self.episode()
        save_options(samples, summary, self._file(self.counts["episodes"] - 1))
        self._samples.append(samples)
        # Episodes are noted under the round number of actions of the next fit.
        step = (self.counts["fits"] + 1) * self._run.schedule.evaluate_every
        yield [Line("episode", step, {"executed": self.executed, **summary})]

    def catch_up(self, step: int) -> list[Line]:
        """Fit new networks to everything remembered."""
        return [Line("fit", step, self.fit())]

    def _file(self, episode: int) -> Path:
        return self._folder / f"{episode:06d}.safetensors"

    def episode(self) -> tuple[OptionSamples, dict[str, Any]]:
        """Go through one episode on a random heap; return what was tried, and its summary."""
        heap, seed = int(self._rng.choice(self._heaps)), int(self._rng.integers(2**31))
        obs, info = self._env.reset(seed=seed, options={"heap": heap})
        self.policy.reset(self._rng)
        samples: list[OptionSamples] = []
        explored, end = 0, None
        while end is None:
            tried = self._tried(obs, seed, samples)
            explores = not self.policy.networks or self._rng.random() < self.config.explore
            explored += explores
            decided = self._explored(obs, tried) if explores else self.policy.decide(obs)
            rollout = roll_out(self._env, obs, _proposed(decided))
            if not rollout.actions:
                continue
            obs, end, info = dict(rollout.obs), rollout.end, dict(rollout.info)
            self.counts["executed"] += len(rollout.actions)
        self.counts["episodes"] += 1
        summary = {
            "heap": heap, "end": end, "pushes": info["pushes"], "grasps": info["grasps"],
            "removals": info["removals"], "explored": explored,
            "retrieved": float(info["retrieved"]),
        }  # fmt: skip
        return OptionSamples.joined(samples), summary

    def _tried(self, obs: Observation, seed: int, samples: list[OptionSamples]) -> list[Option]:
        """Try options from here, and keep what they came to; return them."""
        policy, view = self.policy, self.policy.grasper.view(obs)
        if not view.mask.any():
            return []
        situation = policy.situation(view, policy.grasper.candidates(view))
        options = policy.options(obs, view)
        tried = self._choose(options, policy.judge(options, situation))
        if tried:
            start = self._env.snapshot()
            came_to = [self._try(start, each, seed) for each in tried]
            learnt = [i for i, found in enumerate(came_to) if found is not None]
            views = view_options([tried[i] for i in learnt], situation)
            found = np.array([came_to[i] for i in learnt], np.float64).reshape(-1, 2)
            samples.append(OptionSamples.of(views, *found.T.tolist()))
        return tried

    def _explored(self, obs: Observation, tried: Sequence[Option]) -> Option | Candidate:
        """Return a random decision: half of them are grasps, so that failed ones are seen too."""
        if tried and self._rng.random() < 0.5:
            return tried[int(self._rng.integers(len(tried)))]
        grasper = self.policy.grasper
        view = grasper.view(obs)
        return self.policy.grasp(view, grasper.candidates(view))

    def _choose(self, options: Sequence[Option], worth: Array) -> list[Option]:
        """Return the options to try: all removals, the best pushes, and random ones."""
        removals = [o for o in options if isinstance(o, RemovalOption)]
        pushes = [i for i, o in enumerate(options) if isinstance(o, PushOption)]
        order = sorted(pushes, key=lambda i: -worth[i])
        ranked = round(self.config.ranked * self.config.tries)
        rest = order[ranked:]
        count = min(self.config.tries - ranked, len(rest))
        drawn = self._rng.permutation(len(rest))[:count].tolist()
        chosen = [*order[:ranked], *(rest[i] for i in drawn)]
        return [*removals, *(options[i] for i in chosen)]

    def _try(
        self, start: dict[str, Array], option: Option, seed: int
    ) -> tuple[float, float] | None:
        """Return the chance of the best grasp after an option, and the clutter that it moved.

        Nothing is learnt where it was cut off or the simulator failed.
        """
        obs = self._twin.restore(from_start(start))
        rollout = roll_out(self._twin, obs, _proposed(option))
        self.counts["simulated"] += len(rollout.actions)
        if rollout.end not in (None, "retrieved", "lost"):
            return None
        if rollout.end is not None:
            return float(rollout.end == "retrieved"), rollout.clutter_moved
        # The same proposals for every option: what differs is the heap.
        self._rater.reset(np.random.default_rng(seed))
        end = self._twin.snapshot()
        grasps = self._rater.candidates(self._rater.view(self._eyes.restore(end)))
        if not grasps:
            return 0.0, rollout.clutter_moved
        best = grasps[0]
        info = self._twin.step(Decision.grasp(best.pose, best.gripper).vector())[4]
        self.counts["simulated"] += 1
        if info["failure"] is not None:
            return None
        return (best.quality + float(info["retrieved"])) / 2, rollout.clutter_moved

    def fit(self) -> dict[str, float]:
        """Fit new networks to everything remembered; return what the log notes."""
        samples = OptionSamples.joined(self._samples)
        networks, losses = [], []
        for i in range(self.config.networks if len(samples) else 0):
            seed = int(
                np.random.default_rng([self._run.seed, self.counts["fits"], i]).integers(2**31)
            )
            torch.manual_seed(seed)
            network = RetrievalValue(self.config.value)
            losses.append(fit_options(network, samples, seed))
            networks.append(network)
        self.policy = self._policy(networks)
        self.counts["fits"] += 1
        loss = {"loss": float(np.mean(losses))} if losses else {}
        return {**loss, "options": len(samples), **self.counts}

    def archive(self) -> tuple[NamedTensors, dict[str, Any]]:
        """Return tensors and JSON that `restore` takes back."""
        generator = json.dumps(self._rng.bit_generator.state)
        return tensors_of(self.policy.networks), {"counts": self.counts, "generator": generator}

    def restore(self, tensors: NamedTensors, facts: Mapping[str, Any]) -> None:
        """Go back to where `archive` was called; the episodes until then are read again.

        Raises:
            MechSearchError: If a file is missing or damaged, or of other networks.
        """
        self.counts = {**self.counts, **facts["counts"]}
        self._rng.bit_generator.state = json.loads(facts["generator"])
        # Where nothing could be tried, nothing was fitted.
        count = self.config.networks if tensors else 0
        networks = [RetrievalValue(self.config.value) for _ in range(count)]
        self.policy = self._policy(filled(networks, tensors))
        for number in range(self.counts["episodes"]):
            self._samples.append(load_options(self._file(number)))


def _proposed(decided: Option | Candidate) -> Propose:
    """Return what proposes a decision's vectors one after the other."""
    if isinstance(decided, PushOption):
        return pushing(decided.begun())
    if isinstance(decided, RemovalOption):
        return once(Decision.remove(decided.grasp.pose, decided.grasp.gripper))
    return once(Decision.grasp(decided.pose, decided.gripper))


def save_options(samples: OptionSamples, summary: Mapping[str, Any], path: Path) -> None:
    """Write what an episode taught, whole or not at all."""
    save_archive(path, Archive(_OPTIONS_KIND, vars(samples), {"summary": dict(summary)}))


def load_options(path: Path) -> OptionSamples:
    """Read what an episode taught.

    Raises:
        MechSearchError: If the file is missing or damaged.
    """
    return OptionSamples(**dict(load_archive(path, _OPTIONS_KIND).tensors))


@dataclass(frozen=True)
class RetrievalValues(RetrievalValuesConfig):
    """Learning to retrieve; its options are those of the configuration."""

    @property
    def keys(self) -> tuple[str, ...]:
        """What is seen in retrieval."""
        return RETRIEVAL_KEYS

    @property
    def teachers(self) -> tuple[str, ...]:
        """None: it needs no demonstrations."""
        return ()

    def check(self, task: TaskConfig) -> None:
        """Refuse a task that is no retrieval.

        Raises:
            MechSearchError: Saying so.
        """
        if not isinstance(task, RetrievalTask):
            raise MechSearchError(
                f"retrieval is learnt in a RetrievalTask, not in a {type(task).__name__}; "
                "begin from the variant retrieve, which has one"
            )

    def begin(
        self, run: RunConfig["RetrievalValues"], setup: TrainingSetup, folder: Path
    ) -> RetrievalValuesSession:
        """Return a session at its beginning.

        Raises:
            MechSearchError: If the environment is no retrieval.
        """
        return RetrievalValuesSession(run, setup, folder)

    def save(self, policy: RetrievePolicy) -> tuple[NamedTensors, dict[str, Any]]:
        """Return the networks' weights, and all that deciding by them needs."""
        return tensors_of(policy.networks), {
            "network": asdict(policy.networks[0].config) if policy.networks else {},
            "networks": len(policy.networks),
            "policy": asdict(policy.config),
        }

    def load(self, tensors: NamedTensors, facts: Mapping[str, Any]) -> RetrievePolicy:
        """Return the policy that `save` was given."""
        config = record_from_json(RetrievalValueConfig, facts["network"])
        return RetrievePolicy(
            filled([RetrievalValue(config) for _ in range(int(facts["networks"]))], tensors),
            record_from_json(RetrievePolicyConfig, facts["policy"]),
        )
