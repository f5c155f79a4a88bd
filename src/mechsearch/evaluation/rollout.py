"""Runs a policy on heaps, records every episode, and proves records by playing them again."""

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from importlib.metadata import version
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from mechsearch.env import (
    HeapEnv,
    HeapEnvConfig,
    RetrievalTask,
    RetrieveConfig,
    RetrieveEnv,
    TaskConfig,
    task_from_json,
)
from mechsearch.evaluation.episodes import (
    EpisodeRecord,
    Evaluation,
    RetrievalRecord,
    load_episodes,
)
from mechsearch.evaluation.frames import recorded_environment
from mechsearch.evaluation.policies import (
    RETRIEVAL,
    RETRIEVE,
    SHIPPED_POLICIES,
    Equipped,
    ObservationWrapper,
    actor_of,
    card,
    check_view,
    checked_policy,
    config_of_run,
    goal_of,
    policy_named,
    task_of,
)
from mechsearch.files import differing_fields, fingerprint
from mechsearch.heaps.dataset import Heap, HeapSet, embedded_file, evenly_spread, open_heaps
from mechsearch.objects.model import ObjectModel, ObjectSet
from mechsearch.observe.observation import OnDemand
from mechsearch.processes import Failure, Mapper, Progress, map_in_order, silent
from mechsearch.sim import engine_version
from mechsearch.types import (
    RETRIEVAL_KEYS,
    Array,
    MechSearchError,
    Observation,
    Policy,
    Weighed,
    select,
)

EPISODE_LIMIT = 600.0
"""Time after which an episode hangs [s]; it takes a few seconds."""


_COMPARED = ("actions", "ee_positions", "poses", "occlusions", "clutter_moved", "target_moved")


AnyEnv = HeapEnv | RetrieveEnv


@runtime_checkable
class Planner(Policy, Protocol):
    """A policy that looks at the simulator itself before an episode begins."""

    simulated_actions: int
    """Actions simulated to plan the present episode, none of them executed."""

    def plan(self, env: AnyEnv) -> None:
        """Plan from where an environment is, and leave it there."""


@dataclass(frozen=True)
class EvaluationPlan:
    """One policy on the heaps of one file; all that a worker process needs to know.

    Attributes:
        policy: Text for `policy_named`, or a policy, which must pickle to get to a worker process.
        heaps: File of the heap set; None takes the embedded heaps of household objects, single
            ones but for the policy "retrieve-dual".
        name: Under which the policy is reported; empty takes the name of the run that it comes
            from, or else `policy`.
        objects: Object set; empty takes the one that the heap set names.
        split: "held-out", "train" or "all" heaps.
        limit: Number of heaps, spread evenly over the split; 0 takes all.
        seed: Of the policy's own randomness; starts depend on the heap alone.
        task: The task; None takes that of the run that the policy comes from, or else the default
            one through the heap set's camera.
        grippers: Names of the robot's grippers, of which the first pushes, for a policy that
            retrieves; empty takes those of the task.
    """

    policy: str | Policy
    heaps: Path | None = None
    name: str = ""
    objects: str = ""
    split: str = "held-out"
    limit: int = 0
    seed: int = 0
    task: TaskConfig | None = None
    grippers: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if isinstance(self.policy, ObservationWrapper):
            object.__setattr__(self, "policy", self.policy.policy)
        if self.limit < 0 or self.seed < 0:
            raise MechSearchError(
                f"limit is {self.limit} and seed {self.seed}; expected neither below 0"
            )

    @cached_property
    def run(self) -> Mapping[str, Any]:
        """Configuration of the run that the policy comes from; empty for others."""
        return config_of_run(self.policy) if isinstance(self.policy, str) else {}

    @property
    def policy_text(self) -> str:
        """The policy's text, or the name of its class."""
        return self.policy if isinstance(self.policy, str) else type(self.policy).__name__

    @property
    def title(self) -> str:
        """The name under which the policy is reported."""
        own = str(self.run.get("name", self.policy_text))
        return self.name or "-".join((own, *self.grippers))


def run(
    policy: Policy,
    env: AnyEnv,
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
    policy: Policy, env: AnyEnv, index: int, seed: int = 0, name: str = "policy"
) -> EpisodeRecord:
    """Return one episode from the heap's own start; see `run`."""
    episode = RunningEpisode(env, index, name)
    begin(policy, env, seed, name)
    with _images_on_demand(policy, env):
        while not episode.end:
            obs = episode.obs
            seen = obs.only(policy.keys) if isinstance(obs, OnDemand) else select(obs, policy.keys)
            episode.step(_ask(name, policy.act, seen))
    return episode.record


@contextmanager
def _images_on_demand(policy: Policy, env: AnyEnv) -> Iterator[None]:
    """Make images for a policy that says so, by `on_demand`, only when it reads them."""
    if not (getattr(policy, "on_demand", False) and isinstance(env, HeapEnv)):
        yield
        return
    before, env.on_demand = env.on_demand, True
    try:
        yield
    finally:
        env.on_demand = before


def begin(policy: Policy, env: AnyEnv, seed: int, name: str) -> None:
    """Let a policy begin on the heap that an environment has just been reset to; see `run`."""
    _ask(name, policy.reset, np.random.default_rng([seed, env.heap.seed]))
    if isinstance(policy, Planner):
        _ask(name, policy.plan, env)


class RunningEpisode:
    """An episode from a heap's own start, action by action.

    Attributes:
        obs: What is seen now.
        end: How it ended; empty while it goes on.
    """

    def __init__(self, env: AnyEnv, index: int, name: str) -> None:
        """Put the heap of an index on the table; `name` is who acts."""
        self._env, self._name = env, name
        self.obs, _ = env.reset(options={"heap": index, "fixed_start": True})
        self.end = ""
        self._states, self._actions, self._infos = [env.state], list[Array](), list[Any]()

    def step(self, action: Array) -> None:
        """Carry out an action.

        Raises:
            MechSearchError: If it is none; who acted is named.
        """
        try:
            self.obs, _, _, _, info = self._env.step(action)
        except MechSearchError as error:
            raise MechSearchError(f"at an action of policy {self._name}: {error}") from error
        self._actions.append(np.asarray(action, self._env.action_space.dtype))
        self._infos.append(info)
        # After a failure only the state before it can be trusted.
        self._states.append(self._states[-1] if info["failure"] else self._env.state)
        self.end = info["end"] or ""

    @property
    def record(self) -> EpisodeRecord:
        """What happened so far."""
        heap, states, steps = self._env.heap, self._states, self._infos
        shape = self._env.action_space.shape or ()
        return EpisodeRecord(
            heap_seed=heap.seed,
            count=heap.count,
            condition=heap.condition,
            policy=self._name,
            objects=heap.objects,
            target=heap.target,
            actions=np.array(self._actions).reshape(-1, *shape),
            ee_positions=np.stack([state.ee_position for state in states]),
            occlusions=np.array([state.occlusion for state in states]),
            poses=np.stack([state.poses for state in states]),
            reward_terms={
                term: np.array([step["reward_terms"][term] for step in steps])
                for term in (steps[0]["reward_terms"] if steps else ())
            },
            clutter_moved=np.array([step["clutter_moved"] for step in steps]),
            target_moved=np.array([step["target_moved"] for step in steps]),
            end=self.end,
            action_limit=self._env.config.max_actions,
            retrieval=_retrieval(steps) if isinstance(self._env, RetrieveEnv) else None,
        )


def _retrieval(infos: Sequence[Mapping[str, Any]]) -> RetrievalRecord:
    outcomes = tuple(str(info["outcome"]) for info in infos)
    return RetrievalRecord(outcomes, tuple(tuple(info["held"]) for info in infos))


def _ask(name: str, method: Callable[..., Any], *args: Any) -> Any:
    """Return a policy's answer; what it raises is its own fault and not the heap's."""
    try:
        return method(*args)
    except MechSearchError:
        raise
    except Exception as error:
        text = " ".join(f"{type(error).__name__}: {error}".split())
        raise MechSearchError(f"policy {name} raised {text}") from error


def evaluate(
    policy: str | Path | Policy,
    heaps: Path | str | None = None,
    objects: str = "",
    split: str = "held-out",
    limit: int = 0,
    seed: int = 0,
    task: TaskConfig | None = None,
    workers: int = 1,
    grippers: Sequence[str] = (),
) -> Evaluation:
    """Return one episode of a policy on each of some heaps: what `mechsearch evaluate` records.

    Args:
        policy: As on the command line, or a policy itself, which must pickle where `workers` > 1.
        heaps: Heap set file; this and all else is as in an `EvaluationPlan`.
        objects: Object set.
        split: "held-out", "train" or "all" heaps.
        limit: Number of heaps; 0 takes all.
        seed: Of the policy's own randomness.
        task: The task.
        workers: Processes; the episodes do not depend on their number.
        grippers: Names of the robot's grippers, for a policy that retrieves.

    Raises:
        MechSearchError: If something is named that does not exist or fit, the policy cannot see in
            this task, or no episode could be run.
    """
    file = None if heaps is None else Path(heaps)
    who = str(policy) if isinstance(policy, Path) else policy
    return evaluate_plan(
        EvaluationPlan(who, file, "", objects, split, limit, seed, task, tuple(grippers)),
        workers,
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


def planned_header(plan: EvaluationPlan) -> dict[str, Any]:
    """Return what an evaluation of a plan will say that it was made of; see `other_inputs`.

    Raises:
        MechSearchError: If the plan cannot be carried out.
    """
    rollouts = _Rollouts(plan)
    return rollouts.header | {"heaps": len(rollouts.heap_set.choose(plan.split, plan.limit))}


def opened(plan: EvaluationPlan, also: Sequence[str] = ()) -> tuple[Policy, AnyEnv, list[int]]:
    """Return a plan's policy, its environment, and the indices of its heaps.

    Args:
        plan: What is planned.
        also: Observation keys beside those of the policy.

    Raises:
        MechSearchError: If the plan cannot be carried out.
    """
    rollouts = _Rollouts(plan)
    keys = dict.fromkeys((*rollouts.policy.keys, *also))
    heap_set, objects = rollouts.opened
    env = make_environment(heap_set.heaps, objects, rollouts.task, [*keys])
    return rollouts.policy, env, [*heap_set.choose(plan.split, plan.limit)]


_NO_INPUTS = (
    *("version", "engine", "fingerprint", "object_set", "task_differs"),
    *("quarantined", "simulated_actions"),
)
"""What of a header is of the program, or follows from the rest."""

_LATER = {
    "mounted": TaskConfig.mounted,
    "sensor": TaskConfig.sensor,
    "engine": TaskConfig.engine,
    "segmenter": TaskConfig.segmenter,
    "stop": TaskConfig.stop,
    "robot": TaskConfig.robot,
}
"""What of the task earlier versions had not, and how it was then."""


def other_inputs(one: Mapping[str, Any], other: Mapping[str, Any]) -> tuple[str, ...]:
    """Return in what inputs the headers of two evaluations differ, such as "split" or "heap set".

    The program's version is none: a later one may score the same anew.
    """
    both = [{**header, "env": _LATER | header.get("env", {})} for header in (one, other)]
    names = dict.fromkeys((*one, *other))
    named = [n for n in names if n not in _NO_INPUTS and both[0].get(n) != both[1].get(n)]
    return tuple(name.replace("_", " ") for name in named)


def differing(one: TaskConfig, other: TaskConfig) -> tuple[str, ...]:
    """Return in what another task differs from one, such as "reward.movement 75 -> 100"."""
    return tuple(
        f"{name} {str(before).removesuffix('.0')} -> {str(now).removesuffix('.0')}"
        for name, before, now in differing_fields(one, other)
    )


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
        policy, text = self.plan.policy, self.plan.policy_text
        return policy_named(policy) if isinstance(policy, str) else checked_policy(policy, text)

    @cached_property
    def opened(self) -> tuple[HeapSet, ObjectSet]:
        policy = self.plan.policy
        shipped = isinstance(policy, str) and policy in SHIPPED_POLICIES
        condition = card(str(policy))["trained_on"]["condition"] if shipped else "single"
        # Of heaps of both kinds, "single+dual", the first kind stands for all.
        embedded = embedded_file(condition.partition("+")[0])
        return open_heaps(self.plan.heaps or embedded, self.plan.objects)

    @property
    def heap_set(self) -> HeapSet:
        return self.opened[0]

    @cached_property
    def own_task(self) -> TaskConfig:
        return self._for_goal(task_of(self.policy, self.plan.run, self.heap_set.camera))

    @cached_property
    def task(self) -> TaskConfig:
        task = self._for_goal(self.plan.task) if self.plan.task else self.own_task
        check_view(self.policy, self.plan.run, task, self.plan.title)
        if isinstance(task, RetrievalTask) and isinstance(self.policy, Equipped):
            self.policy.equip(task.grippers)
        return task

    def _for_goal(self, task: TaskConfig) -> TaskConfig:
        """Return a task for what the policy is after, with the grippers that are asked for."""
        grippers = self.plan.grippers
        if goal_of(self.policy) == RETRIEVE:
            task = RetrieveConfig.of_task(task, RETRIEVAL_KEYS)
            return replace(task, grippers=grippers) if grippers else task
        if grippers:
            raise MechSearchError(
                f"{self.plan.policy_text} uncovers, and has no use for {'+'.join(grippers)}; "
                "expected a policy that retrieves"
            )
        return task

    @cached_property
    def env(self) -> AnyEnv:
        return make_environment(self.heap_set.heaps, self.opened[1], self.task, self.policy.keys)

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
            "env": asdict(environment_config(self.task, self.policy.keys)),
            "task_differs": differing(self.own_task, self.task),
            "engine": engine_version(self.task.engine),
            "version": version("mechsearch"),
            "fingerprint": fingerprint(),
        }
        if isinstance(self.task, RetrievalTask):
            header["goal"] = RETRIEVE
        if isinstance(plan.policy, str) and (actor := actor_of(plan.policy)):
            header["actor"] = actor
        # As it will be read back: lists for tuples.
        plain: dict[str, Any] = json.loads(json.dumps(header))
        return plain


def make_environment(
    heaps: Sequence[Heap],
    objects: ObjectSet,
    task: TaskConfig,
    keys: Sequence[str],
    privileged: bool = False,
    render_mode: str | None = None,
) -> AnyEnv:
    """Return the environment of a task: a `RetrieveEnv` of a `RetrievalTask`, else a `HeapEnv`.

    Args:
        heaps: Start states.
        objects: The set that their names refer to.
        task: The task.
        keys: Observation keys.
        privileged: Whether to add the keys that critic and teachers read.
        render_mode: "rgb_array" or None.
    """
    config = environment_config(task, keys, privileged)
    if isinstance(config, RetrieveConfig):
        return RetrieveEnv(heaps, objects, config, render_mode)
    return HeapEnv(heaps, objects, config, render_mode)


def environment_config(
    task: TaskConfig, keys: Sequence[str], privileged: bool = False
) -> HeapEnvConfig | RetrieveConfig:
    """Return the configuration of the environment that `make_environment` makes."""
    kind = RetrieveConfig if isinstance(task, RetrievalTask) else HeapEnvConfig
    return kind.of_task(task, keys, privileged)


@dataclass(frozen=True)
class EpisodeCheck:
    """What playing one recorded episode again has shown.

    Attributes:
        heap_seed: Of its heap.
        differences: What came out otherwise, such as "occlusions from action 3 on"; empty if every
            bit is as recorded.
    """

    heap_seed: int
    differences: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Whether every bit is as recorded."""
        return not self.differences


def replay_all(
    evaluation: Evaluation,
    heaps: Path,
    objects: str = "",
    workers: int = 1,
    progress: Progress = silent,
    mapper: Mapper = map_in_order,
) -> Iterator[EpisodeCheck]:
    """Yield what playing each episode again shows, in their order.

    Physics, occlusion and reward are computed anew from heap, starting point and actions; the
    policy is not asked again. The bits are the same under the engine's version in the header.

    Args:
        evaluation: The recorded episodes.
        heaps: File of the heap set that they ran on.
        objects: Object set; empty takes the one that the evaluation names.
        workers: Processes.
        progress: Told after each episode.
        mapper: How the episodes are spread.

    Raises:
        MechSearchError: If the heap set is another, or the objects are.
    """
    spec = objects or str(evaluation.header["object_set"])
    heap_set, _ = open_heaps(heaps, spec)
    if heap_set.hash != evaluation.header["heap_set"]:
        raise MechSearchError(
            f"{heaps} has the hash {heap_set.hash[:12]}; these episodes ran on the heap set "
            f"{str(evaluation.header['heap_set'])[:12]}"
        )
    kind = RetrieveConfig if evaluation.header.get("goal") == RETRIEVE else HeapEnvConfig
    config = task_from_json(kind, evaluation.header["env"])
    name = f"{evaluation.header['name']} played again"
    again = play_all(name, evaluation.episodes, config, heaps, spec, workers, progress, mapper)
    for record, played in zip(evaluation.episodes, again, strict=True):
        found = (played,) if isinstance(played, str) else record_differences(record, played)
        yield EpisodeCheck(record.heap_seed, found)


class RecordedActions(Protocol):
    """An episode of which what was done is known, whatever came of it; see `EpisodeRecord`."""

    @property
    def heap_seed(self) -> int:
        """Seed of the heap."""

    @property
    def condition(self) -> str:
        """Such as "single"."""

    @property
    def policy(self) -> str:
        """Who acted."""

    @property
    def actions(self) -> Array:
        """Commands (T, 3), or decisions (T, 9)."""


def play_all(
    name: str,
    episodes: Sequence[RecordedActions],
    config: HeapEnvConfig,
    heaps: Path,
    objects: str = "",
    workers: int = 1,
    progress: Progress = silent,
    mapper: Mapper = map_in_order,
    idle: bool = False,
) -> Iterator[EpisodeRecord | str]:
    """Yield what comes of the actions of each episode, or why nothing does, in their order.

    Args:
        name: Of the whole, for `progress`.
        episodes: What was done.
        config: The task.
        heaps: File of the heap set.
        objects: Object set; empty takes the one that the heaps were made with.
        workers: Processes.
        progress: Told after each episode.
        mapper: How the episodes are spread.
        idle: Whether nothing more is done after the last action; otherwise an episode that is not
            over then is an error.
    """
    # No image is looked at: what is recorded does not depend on what the policy saw.
    play = _Play(heaps, objects, replace(config, keys=("ee_position",)), idle)
    results = mapper(play, episodes, workers, EPISODE_LIMIT, _failed)
    for i, found in enumerate(results):
        progress(name, i + 1, len(episodes))
        yield found


def begun_again(
    header: Mapping[str, Any],
    record: EpisodeRecord,
    models: Mapping[str, ObjectModel],
    keys: Sequence[str],
) -> tuple[AnyEnv, dict[str, Array]]:
    """Return an environment at the start of a recorded episode, and what is seen there.

    Args:
        header: Of the evaluation.
        record: The episode; its heap set is not needed.
        models: Objects by name.
        keys: Observation keys.
    """
    kind = RetrieveConfig if record.retrieval else HeapEnvConfig
    config = environment_config(task_from_json(kind, header["env"]), keys)
    env = recorded_environment(config, record, models)
    return env, env.reset(options={"heap": 0, "fixed_start": True})[0]


def weighed_again(
    header: Mapping[str, Any],
    record: EpisodeRecord,
    models: Mapping[str, ObjectModel],
    policy: str = "",
    progress: Progress = silent,
) -> list[Weighed | None]:
    """Return what the policy weighed before each action, by asking it again in the same physics.

    It ends where the policy decides otherwise than it was recorded, as it may on another machine.

    Args:
        header: Of the evaluation.
        record: The episode.
        models: Objects by name.
        policy: Who acted, as for `make_policy`. By default it is the one that the header names, if
            it is shipped or built in: what a file names is not run.
        progress: Told after each action.

    Raises:
        MechSearchError: If there is no such policy.
    """
    named = str(header["policy"])
    if not policy and named not in (*SHIPPED_POLICIES, *RETRIEVAL):
        return []
    try:
        who = policy_named(policy or named)
    except MechSearchError:
        if policy:
            raise
        # Without PyTorch there is an episode to see all the same.
        return []
    if not hasattr(who, "weighed"):
        return []
    env, obs = begun_again(header, record, models, who.keys)
    if isinstance(env.config, RetrieveConfig) and isinstance(who, Equipped):
        who.equip(env.config.grippers)
    begin(who, env, header["seed"], named)
    found = []
    for step, action in enumerate(record.actions):
        if not np.allclose(_ask(named, who.act, select(obs, who.keys)), action, atol=1e-6):
            break
        found.append(who.weighed)
        progress(f"what {named} weighed", step + 1, len(record.actions))
        obs, _, _, _, info = env.step(action)
        if info["end"]:
            break
    return found


def record_differences(recorded: EpisodeRecord, played: EpisodeRecord) -> tuple[str, ...]:
    """Return in what two records of an episode differ, bit by bit."""
    pairs = {name: (getattr(recorded, name), getattr(played, name)) for name in _COMPARED}
    nothing = np.empty(0)
    for term in dict.fromkeys((*recorded.reward_terms, *played.reward_terms)):
        both = [record.reward_terms.get(term, nothing) for record in (recorded, played)]
        pairs[f"reward term {term}"] = (both[0], both[1])
    found = []
    for name, (before, now) in pairs.items():
        if before.shape != now.shape:
            found.append(f"{name} of {len(now)} entries instead of {len(before)}")
        elif before.tobytes() != now.tobytes():
            found.append(f"{name} from {_first(before, now)} on")
    if recorded.retrieval != played.retrieval:
        found.append("outcomes of decisions, or what came up")
    if recorded.end != played.end:
        found.append(f"the end, {played.end!r} instead of {recorded.end!r}")
    return tuple(found)


def _first(before: Array, now: Array) -> int:
    """Return the first row that differs."""
    rows = (len(before), -1)
    return int(np.argmax((before.reshape(rows) != now.reshape(rows)).any(axis=1)))


def _failed(record: RecordedActions, failure: Failure) -> str:
    return failure.reason


@dataclass(frozen=True)
class _Play:
    """Plays recorded episodes again, in whichever process."""

    heaps: Path
    objects: str
    config: HeapEnvConfig
    idle: bool

    def __call__(self, record: RecordedActions) -> EpisodeRecord | str:
        env = self._env
        named = (record.heap_seed, record.condition)
        found = [i for i, h in enumerate(env.heaps) if (h.seed, h.condition) == named]
        if not found:
            return "its heap is not in the set"
        try:
            again = _Recorded(record.actions, self.idle)
            return run_episode(again, env, found[0], name=record.policy)
        except MechSearchError as error:
            return str(error)

    @cached_property
    def _env(self) -> AnyEnv:
        heap_set, objects = open_heaps(self.heaps, self.objects)
        return make_environment(heap_set.heaps, objects, self.config, self.config.keys)


class _Recorded:
    """A policy that repeats recorded actions."""

    keys: tuple[str, ...] = ("ee_position",)

    def __init__(self, actions: Array, idle: bool) -> None:
        self._actions, self._size, self._idle = iter(actions), actions.shape[1:], idle

    def reset(self, rng: np.random.Generator) -> None:
        """Begin; there is nothing to draw."""

    def act(self, obs: Observation) -> Array:
        """Return the next recorded action."""
        action = next(self._actions, None)
        if action is None and self._idle:
            return np.zeros(self._size)
        if action is None:
            raise MechSearchError("it goes on after the last recorded action")
        return np.asarray(action)


def load_some(path: Path, limit: int) -> Evaluation:
    """Read an evaluation, and keep so many of its episodes, evenly spread; all for 0.

    Raises:
        MechSearchError: As `load_episodes`, or if there are not so many.
    """
    evaluation = load_episodes(path)
    count = len(evaluation.episodes)
    if not 0 <= limit <= count:
        raise MechSearchError(f"limit is {limit}; {path} has {count} episodes")
    chosen = tuple(evaluation.episodes[i] for i in evenly_spread(count, limit or count))
    return Evaluation(evaluation.header, chosen)
