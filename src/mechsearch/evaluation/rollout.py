"""Runs a policy on heaps and records every episode."""

import json
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig
from mechsearch.evaluation.episodes import EpisodeRecord, Evaluation
from mechsearch.evaluation.look_ahead import Planner
from mechsearch.evaluation.policies import make_policy, run_config
from mechsearch.files.fingerprint import fingerprint
from mechsearch.heaps.dataset import HeapSet, check_objects, load_heaps
from mechsearch.heaps.heap import evenly_spread
from mechsearch.objects.catalog import load_object_set
from mechsearch.processes import (
    Failure,
    Mapper,
    Progress,
    map_in_order,
    silent,
)
from mechsearch.sim.world import ENGINE_VERSION
from mechsearch.types import Array, MechSearchError, Observation, Policy, select

SPLITS = ("held-out", "train", "all")

EPISODE_LIMIT = 600.0
"""Time after which an episode hangs [s]; it takes a few seconds."""


@dataclass(frozen=True)
class EvaluationPlan:
    """One policy on the heaps of one file; all that a worker process needs to know.

    Attributes:
        policy: Text for `make_policy`.
        heaps: File of the heap set.
        name: Under which the policy is reported; empty takes the name of the run that it comes
            from, or else `policy`.
        objects: Object set; empty takes the one that the heap set names.
        split: "held-out", "train" or "all" heaps.
        limit: Number of heaps, spread evenly over the split; 0 takes all.
        seed: Of the policy's own randomness; starts depend on the heap alone.
        camera: View of images and occlusion; empty takes the one that the policy was trained with,
            or else the heap set's.
        env: The rest of the task; its keys are replaced by those that the policy reads.
    """

    policy: str
    heaps: Path
    name: str = ""
    objects: str = ""
    split: str = "held-out"
    limit: int = 0
    seed: int = 0
    camera: str = ""
    env: HeapEnvConfig = field(default_factory=HeapEnvConfig)

    def __post_init__(self) -> None:
        if self.split not in SPLITS:
            raise MechSearchError(
                f"unknown split {self.split!r}; choose one of {', '.join(SPLITS)}"
            )
        if self.limit < 0 or self.seed < 0:
            raise MechSearchError(
                f"limit is {self.limit} and seed {self.seed}; expected neither below 0"
            )

    @property
    def title(self) -> str:
        """The name under which the policy is reported."""
        return self.name or str(run_config(self.policy).get("name", self.policy))


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
    plan: EvaluationPlan,
    workers: int = 1,
    progress: Progress = silent,
    mapper: Mapper = map_in_order,
) -> Evaluation:
    """Return all episodes of a plan, the same whatever the number of workers.

    A worker process that dies or hangs costs time only: its episode is run again. A heap that fails
    twice is quarantined: `quarantined` in the header has its seed and the reason, and `heaps` there
    is the number of episodes and quarantined heaps together.

    Args:
        plan: Policy, heaps and task.
        workers: Number of processes.
        progress: Told after each episode.
        mapper: How the episodes are spread.

    Raises:
        MechSearchError: If the plan cannot be carried out, or no episode could be run.
    """
    # Files may have changed since an equal plan was carried out in this process.
    _prepared.cache_clear()
    env, heap_set, indices, policy = _prepared(plan)
    name = plan.title
    records: list[EpisodeRecord] = []
    simulated = 0
    quarantined: list[dict[str, Any]] = []
    results = mapper(_Episode(plan, name), indices, workers, EPISODE_LIMIT, _quarantine)
    for i, (index, result) in enumerate(zip(indices, results, strict=True)):
        if isinstance(result, Failure):
            quarantined.append({"heap": env.heaps[index].seed, "reason": result.reason})
        else:
            records.append(result[0])
            simulated += result[1]
        progress(name, i + 1, len(indices))
    if not records:
        first = quarantined[0]
        raise MechSearchError(
            f"all {len(indices)} heaps failed twice; the first, {first['heap']}: {first['reason']}"
        )
    header = _header(plan, env, heap_set, policy)
    header |= {"heaps": len(indices), "quarantined": quarantined}
    if isinstance(policy, Planner):
        header["simulated_actions"] = simulated
    return Evaluation(header, tuple(records))


def file_name(evaluation: Evaluation) -> str:
    """Return a name for an evaluation's file that tells seeds and lengths of training apart."""
    header = evaluation.header
    words = [header["name"]]
    if header["trained"]:
        words += [f"seed{header['training_seed']}", f"{header['training_actions']}"]
    return re.sub(r"[^\w.+-]+", "-", "-".join(words)).strip("-")


def _quarantine(index: int, failure: Failure) -> Failure:
    return failure


@dataclass(frozen=True)
class _Episode:
    """One heap's episode and the actions simulated to plan it, in whichever process."""

    plan: EvaluationPlan
    name: str

    def __call__(self, index: int) -> tuple[EpisodeRecord, int] | Failure:
        env, _, _, policy = _prepared(self.plan)
        record = run_episode(policy, env, index, self.plan.seed, self.name)
        return record, policy.simulated_actions if isinstance(policy, Planner) else 0


@lru_cache(maxsize=1)
def _prepared(plan: EvaluationPlan) -> tuple[HeapEnv, HeapSet, tuple[int, ...], Policy]:
    """Return a plan's environment, heap set, heap indices and policy, once for each process."""
    heap_set = load_heaps(plan.heaps)
    objects = load_object_set(plan.objects or heap_set.manifest["config"]["objects"])
    check_objects(heap_set, objects)
    policy = make_policy(plan.policy)
    run = run_config(plan.policy)
    config = replace(
        plan.env,
        keys=tuple(policy.keys),
        privileged=False,
        camera=plan.camera or run.get("camera", heap_set.camera),
        image_size=run.get("image_size", plan.env.image_size),
    )
    return HeapEnv(heap_set.heaps, objects, config), heap_set, _chosen(heap_set, plan), policy


def _chosen(heap_set: HeapSet, plan: EvaluationPlan) -> tuple[int, ...]:
    held_out = {"held-out": (True,), "train": (False,), "all": (True, False)}[plan.split]
    indices = [i for i, heap in enumerate(heap_set.heaps) if heap.held_out in held_out]
    if not indices:
        raise MechSearchError(f"{plan.heaps} has no {plan.split} heaps")
    if plan.limit > len(indices):
        raise MechSearchError(
            f"{plan.limit} heaps asked for; {plan.heaps} has {len(indices)} {plan.split} heaps"
        )
    return tuple(indices[i] for i in evenly_spread(len(indices), plan.limit or len(indices)))


def _header(
    plan: EvaluationPlan, env: HeapEnv, heap_set: HeapSet, policy: Policy
) -> dict[str, Any]:
    used = {name for heap in heap_set.heaps for name in heap.objects}
    header = {
        "name": plan.title,
        "policy": plan.policy,
        "keys": list(policy.keys),
        "seed": plan.seed,
        "trained": hasattr(policy, "training_actions"),
        "training_seed": run_config(plan.policy).get("seed"),
        "training_actions": int(getattr(policy, "training_actions", 0)),
        "heap_set": heap_set.hash,
        "condition": heap_set.manifest["config"]["condition"],
        "object_set": plan.objects or heap_set.manifest["config"]["objects"],
        "object_hashes": {
            name: digest
            for name, digest in heap_set.manifest["object_hashes"].items()
            if name in used
        },
        "split": plan.split,
        "env": asdict(env.config),
        "engine": ENGINE_VERSION,
        "version": version("mechsearch"),
        "fingerprint": fingerprint(),
    }
    # As it will be read back: lists for tuples.
    plain: dict[str, Any] = json.loads(json.dumps(header))
    return plain
