"""Runs a policy on heaps and records every episode."""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from importlib.metadata import version
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Any

import numpy as np

from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig, TaskConfig, differing
from mechsearch.env.register import embedded_file
from mechsearch.evaluation.episodes import EpisodeRecord, Evaluation
from mechsearch.evaluation.look_ahead import Planner
from mechsearch.evaluation.policies import (
    SHIPPED_POLICIES,
    check_view,
    checked_policy,
    make_policy,
    run_config,
    task_of,
)
from mechsearch.files import fingerprint
from mechsearch.heaps.dataset import HeapSet, open_heaps
from mechsearch.objects.model import ObjectSet
from mechsearch.processes import Failure, Mapper, Progress, map_in_order, silent
from mechsearch.sim.world import ENGINE_VERSION
from mechsearch.types import Array, MechSearchError, Observation, Policy, select

EPISODE_LIMIT = 600.0
"""Time after which an episode hangs [s]; it takes a few seconds."""


@dataclass(frozen=True)
class EvaluationPlan:
    """One policy on the heaps of one file; all that a worker process needs to know.

    Attributes:
        policy: Text for `make_policy`, or a policy, which must pickle to get to a worker process.
        heaps: File of the heap set; None takes the embedded heaps of household objects, single
            ones but for the policy "dual".
        name: Under which the policy is reported; empty takes the name of the run that it comes
            from, or else `policy`.
        objects: Object set; empty takes the one that the heap set names.
        split: "held-out", "train" or "all" heaps.
        limit: Number of heaps, spread evenly over the split; 0 takes all.
        seed: Of the policy's own randomness; starts depend on the heap alone.
        task: The task; None takes that of the run that the policy comes from, or else the default
            one through the heap set's camera.
    """

    policy: str | Policy
    heaps: Path | None = None
    name: str = ""
    objects: str = ""
    split: str = "held-out"
    limit: int = 0
    seed: int = 0
    task: TaskConfig | None = None

    def __post_init__(self) -> None:
        if self.limit < 0 or self.seed < 0:
            raise MechSearchError(
                f"limit is {self.limit} and seed {self.seed}; expected neither below 0"
            )

    @cached_property
    def run(self) -> Mapping[str, Any]:
        """Configuration of the run that the policy comes from; empty for others."""
        return run_config(self.policy) if isinstance(self.policy, str) else {}

    @property
    def policy_text(self) -> str:
        """The policy's text, or the name of its class."""
        return self.policy if isinstance(self.policy, str) else type(self.policy).__name__

    @property
    def title(self) -> str:
        """The name under which the policy is reported."""
        return self.name or str(self.run.get("name", self.policy_text))


def run(
    policy: Policy,
    env: HeapEnv,
    indices: Sequence[int],
    seed: int = 0,
    name: str = "policy",
    progress: Progress = silent,
) -> list[EpisodeRecord]:
    """Return one episode on each of the heaps, in their order.

    An episode depends on policy, task, heap and seed alone, not on the episodes before it.

    Args:
        policy: Handed its own keys only.
        env: Must offer those keys.
        indices: Of the heaps in `env.heaps`.
        seed: Of the policy's own randomness.
        name: Under which the policy is reported.
        progress: Told after each episode.
    """
    records = []
    for i, index in enumerate(indices):
        records.append(run_episode(policy, env, index, seed, name))
        progress(name, i + 1, len(indices))
    return records


def run_episode(
    policy: Policy, env: HeapEnv, index: int, seed: int = 0, name: str = "policy"
) -> EpisodeRecord:
    """Return one episode from the heap's own start; see `run`."""
    heap = env.heaps[index]
    obs, _ = env.reset(options={"heap": index, "fixed_start": True})
    policy.reset(np.random.default_rng([seed, heap.seed]))
    if isinstance(policy, Planner):
        policy.plan(env)
    states, actions, infos = [env.state], [], [{"end": None}]
    while infos[-1]["end"] is None:
        action = _act(policy, obs, name)
        obs, _, _, _, info = env.step(action)
        actions.append(np.asarray(action, np.float32))
        infos.append(info)
        # After a failure only the state before it can be trusted.
        states.append(states[-1] if info["failure"] else env.state)
    steps: list[dict[str, Any]] = infos[1:]
    return EpisodeRecord(
        heap_seed=heap.seed,
        count=heap.count,
        condition=heap.condition,
        policy=name,
        objects=heap.objects,
        target=heap.target,
        actions=np.stack(actions),
        ee_positions=np.stack([state.ee_position for state in states]),
        occlusions=np.array([state.occlusion for state in states]),
        poses=np.stack([state.poses for state in states]),
        reward_terms={
            term: np.array([step["reward_terms"][term] for step in steps])
            for term in steps[0]["reward_terms"]
        },
        clutter_moved=np.array([step["clutter_moved"] for step in steps]),
        target_moved=np.array([step["target_moved"] for step in steps]),
        end=steps[-1]["end"],
        action_limit=env.config.max_actions,
    )


def _act(policy: Policy, obs: Observation, name: str) -> Array:
    """Return the policy's action; what it raises is its own fault and not the heap's."""
    seen = select(obs, policy.keys)
    try:
        return policy.act(seen)
    except MechSearchError:
        raise
    except Exception as error:
        raise MechSearchError(f"policy {name} raised {type(error).__name__}: {error}") from error


def evaluate(
    policy: str | Policy,
    heaps: Path | str | None = None,
    objects: str = "",
    split: str = "held-out",
    limit: int = 0,
    seed: int = 0,
    task: TaskConfig | None = None,
    workers: int = 1,
) -> Evaluation:
    """Return one episode of a policy on each of some heaps: what `mechsearch evaluate` records.

    Args:
        policy: As on the command line, or a policy itself, which must pickle where `workers` > 1.
        heaps: Heap set file; None takes the embedded heaps of household objects, single ones but
            for the policy "dual".
        objects: Object set; empty takes the one that the heap set names.
        split: "held-out", "train" or "all" heaps.
        limit: Number of heaps, spread evenly over the split; 0 takes all.
        seed: Of the policy's own randomness; starts depend on the heap alone.
        task: The task; None takes that of the run that the policy comes from, or else the default
            one through the heap set's camera.
        workers: Processes; the episodes do not depend on their number.

    Raises:
        MechSearchError: If something is named that does not exist or fit, the policy cannot see in
            this task, or no episode could be run.
    """
    file = None if heaps is None else Path(heaps)
    return evaluate_plan(
        EvaluationPlan(policy, file, "", objects, split, limit, seed, task), workers
    )


def evaluate_plan(
    plan: EvaluationPlan,
    workers: int = 1,
    progress: Progress = silent,
    mapper: Mapper = map_in_order,
) -> Evaluation:
    """Return all episodes of a plan, the same whatever the number of workers.

    A worker process that dies or hangs costs time only: its episode is run again. A heap that fails
    twice is quarantined: `quarantined` in the header has its seed and the reason, and `heaps` there
    is the number of episodes and quarantined heaps together. `task_differs` says in what the task
    is another than the policy's own.

    Args:
        plan: Policy, heaps and task.
        workers: Number of processes.
        progress: Told after each episode.
        mapper: How the episodes are spread.

    Raises:
        MechSearchError: If the plan cannot be carried out, or no episode could be run.
    """
    rollouts = _Rollouts(plan)
    if workers > 1 and not isinstance(plan.policy, str):
        _check_that_it_travels(plan)
    heaps, indices = rollouts.env.heaps, rollouts.heap_set.choose(plan.split, plan.limit)
    records: list[EpisodeRecord] = []
    simulated = 0
    quarantined: list[dict[str, Any]] = []
    results = mapper(rollouts, indices, workers, EPISODE_LIMIT, _quarantine)
    for i, (index, result) in enumerate(zip(indices, results, strict=True)):
        if isinstance(result, Failure):
            quarantined.append({"heap": heaps[index].seed, "reason": result.reason})
        else:
            records.append(result[0])
            simulated += result[1]
        progress(plan.title, i + 1, len(indices))
    if not records:
        first = quarantined[0]
        raise MechSearchError(
            f"all {len(indices)} heaps failed twice; the first, {first['heap']}: {first['reason']}"
        )
    header = rollouts.header | {"heaps": len(indices), "quarantined": quarantined}
    if isinstance(rollouts.policy, Planner):
        header["simulated_actions"] = simulated
    return Evaluation(header, tuple(records))


def in_task(plan: EvaluationPlan, change: Callable[[TaskConfig], TaskConfig]) -> EvaluationPlan:
    """Return a plan in a changed task.

    Args:
        plan: What is planned.
        change: Given the task that the plan is in by default, returns another.

    Raises:
        MechSearchError: If there is no such policy or heap set, or the policy cannot see there.
    """
    changed = replace(plan, task=change(_Rollouts(plan).own_task))
    _ = _Rollouts(changed).task
    return changed


def file_name(evaluation: Evaluation) -> str:
    """Return a name for an evaluation's file that tells seeds and lengths of training apart."""
    header = evaluation.header
    words = [header["name"]]
    if header["trained"]:
        words += [f"seed{header['training_seed']}", f"{header['training_actions']}"]
    return re.sub(r"[^\w.+-]+", "-", "-".join(words)).strip("-")


def _check_that_it_travels(plan: EvaluationPlan) -> None:
    try:
        ForkingPickler.dumps(plan.policy)
    except Exception as error:  # noqa: BLE001
        raise MechSearchError(
            f"the policy {plan.policy_text} cannot be handed to worker processes ({error}); "
            "expected workers=1, or the policy as package.module:factory"
        ) from None


def _quarantine(index: int, failure: Failure) -> Failure:
    return failure


@dataclass(frozen=True)
class _Rollouts:
    """The episodes of a plan, and what they need, prepared once in each process."""

    plan: EvaluationPlan

    def __call__(self, index: int) -> tuple[EpisodeRecord, int] | Failure:
        """Return the episode on a heap, and the number of actions simulated to plan it."""
        record = run_episode(self.policy, self.env, index, self.plan.seed, self.plan.title)
        return record, self.policy.simulated_actions if isinstance(self.policy, Planner) else 0

    def __getstate__(self) -> dict[str, Any]:
        return {"plan": self.plan}

    @cached_property
    def policy(self) -> Policy:
        policy = self.plan.policy
        if isinstance(policy, str):
            return make_policy(policy)
        return checked_policy(policy, self.plan.policy_text)

    @cached_property
    def opened(self) -> tuple[HeapSet, ObjectSet]:
        policy = self.plan.policy
        condition = policy if isinstance(policy, str) and policy in SHIPPED_POLICIES else "single"
        return open_heaps(self.plan.heaps or embedded_file(condition), self.plan.objects)

    @property
    def heap_set(self) -> HeapSet:
        return self.opened[0]

    @cached_property
    def own_task(self) -> TaskConfig:
        return task_of(self.policy, self.plan.run, self.heap_set.camera)

    @cached_property
    def task(self) -> TaskConfig:
        task = self.plan.task or self.own_task
        check_view(self.policy, self.plan.run, task, self.plan.title)
        return task

    @cached_property
    def env(self) -> HeapEnv:
        config = HeapEnvConfig.of_task(self.task, self.policy.keys)
        return HeapEnv(self.heap_set.heaps, self.opened[1], config)

    @property
    def header(self) -> dict[str, Any]:
        plan, heap_set = self.plan, self.heap_set
        used = {name for heap in heap_set.heaps for name in heap.objects}
        hashes = heap_set.manifest["object_hashes"]
        header = {
            "name": plan.title,
            "policy": plan.policy_text,
            "keys": list(self.policy.keys),
            "seed": plan.seed,
            "trained": hasattr(self.policy, "training_actions"),
            "training_seed": plan.run.get("seed"),
            "training_actions": int(getattr(self.policy, "training_actions", 0)),
            "heap_set": heap_set.hash,
            "condition": heap_set.condition,
            "object_set": plan.objects or heap_set.objects,
            "object_hashes": {name: digest for name, digest in hashes.items() if name in used},
            "split": plan.split,
            "env": asdict(self.env.config),
            "task_differs": differing(self.own_task, self.task),
            "engine": ENGINE_VERSION,
            "version": version("mechsearch"),
            "fingerprint": fingerprint(),
        }
        # As it will be read back: lists for tuples.
        plain: dict[str, Any] = json.loads(json.dumps(header))
        return plain
