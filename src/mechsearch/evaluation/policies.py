"""Policies by name: baselines, teachers, trained and shipped ones and users' own."""

import hashlib
import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from mechsearch.entry_point import called, conforming, is_entry_point, load_entry_point
from mechsearch.env import (
    HeapEnv,
    RetrievalTask,
    Rollout,
    TaskConfig,
    imageless,
    roll_out,
    task_from_json,
)
from mechsearch.files import CONFIG_FILE, POLICY_FILE, read_content, read_json, read_record
from mechsearch.observe.observation import readable
from mechsearch.pushes.push import spiral, straight, zigzag
from mechsearch.teachers import TEACHERS, PushTeacher, make_teacher
from mechsearch.types import (
    IMAGE_KEYS,
    Array,
    MechSearchError,
    Observation,
    Policy,
    check_extra,
)

TRAINED_LOADER = "mechsearch.training.run_directory:load_policy"
"""Function that turns a run directory or an actor's file into a policy; needs the `learn` extra."""

RETRIEVAL = {
    "grasp-only": "mechsearch.retrieval.policies:GraspOnly",
    "uncover-then-grasp": "mechsearch.retrieval.policies:UncoverThenGrasp",
    "clear-then-grasp": "mechsearch.retrieval.policies:ClearThenGrasp",
    "retrieve-oracle": "mechsearch.retrieval.policies:RetrieveOracle",
}
"""Baselines and ceiling of retrieval; they rate grasps, which needs the `learn` extra."""

LOOK_AHEAD = "look-ahead"
"""Plans in the simulator, and takes some seconds a heap; a ceiling rather than a baseline."""

SHAPES = (straight, zigzag, spiral)
"""What is tried: pushes of the paper's three teachers."""

WITHOUT_SUCCESS = 100.0
"""What a trial that does not uncover the target is behind those that do."""

SHIPPED_POLICIES = ("uncover", "retrieve", "retrieve-dual")
"""Trained policies that are shipped: one that uncovers in any heap, and looks for a target of which
nothing is seen; two that retrieve."""

UNCOVER, RETRIEVE = "uncover", "retrieve"
"""What a policy is after: its attribute `goal`, the first one where it has none."""

_FOLDER = Path(__file__).with_name("trained")
_VIEW = {"camera": str, "image_size": int}


class RandomPolicy:
    """Commands drawn uniformly from the action box.

    The environment projects each on the ball of 5 cm, so the longest push is the likeliest: the
    ball fills about half of the box.
    """

    keys: tuple[str, ...] = ("ee_position",)

    def reset(self, rng: np.random.Generator) -> None:
        """Draw the coming actions from `rng`."""
        self._rng = rng

    def act(self, obs: Observation) -> NDArray[np.float32]:
        """Return a command (3,) uniform in [-1, 1] along each axis."""
        return self._rng.uniform(-1, 1, 3).astype(np.float32)


class IdlePolicy:
    """Never moves."""

    keys: tuple[str, ...] = ("ee_position",)

    def reset(self, rng: np.random.Generator) -> None:
        """Begin a new episode; there is nothing to draw."""

    def act(self, obs: Observation) -> NDArray[np.float32]:
        """Return the command (3,) that stays in place."""
        return np.zeros(3, np.float32)


@dataclass(frozen=True)
class LookAheadConfig:
    """How far to look.

    Attributes:
        directions: Directions tried for each teacher.
        margin: A trial this far behind the best return so far is given up.
        gentleness: What each metre that the mean non-target object moves costs a trial, beyond
            its reward.
        tolerance: Of the trials this close to the best score, the one that sets out most directly
            for the target is taken.
    """

    directions: int = 8
    margin: float = 2.5
    gentleness: float = 50.0
    tolerance: float = 1.0


class LookAheadPolicy:
    """The best push found from an episode's start, executed to its end: the ceiling of pushes.

    It needs snapshots of the simulator, which no robot has: it shows how well pushes can do. Its
    trial actions are simulated, not executed, and are counted apart.
    """

    keys: tuple[str, ...] = ("ee_position",)

    def __init__(self, config: LookAheadConfig | None = None) -> None:
        """Set how far to look."""
        self._config = config or LookAheadConfig()
        self._env: HeapEnv | None = None
        self.simulated_actions = 0

    def reset(self, rng: np.random.Generator) -> None:
        """Forget the last plan; trials draw from the heap's own seed."""
        self._actions: list[NDArray[np.float32]] = []
        self.simulated_actions = 0

    def plan(self, env: HeapEnv) -> None:
        """Try every push from where the environment is, and keep the best to its end."""

        def score(rollout: Rollout) -> float:
            return rollout.reward - config.gentleness * rollout.clutter_moved

        def is_hopeless(rollout: Rollout) -> bool:
            return score(rollout) < best - config.margin

        if env is not self._env:
            self._env, self._twin = env, imageless(env)
        config, twin, snapshot = self._config, self._twin, env.snapshot()
        offset = twin.restore(snapshot)["target_offset"]
        towards = offset / max(float(np.linalg.norm(offset)), 1e-6)
        tried: list[tuple[float, NDArray[np.float32]]] = []
        best = -np.inf
        for i in range(config.directions):
            for shape in SHAPES:
                teacher = PushTeacher(shape, 2 * np.pi * i / config.directions)
                teacher.reset(np.random.default_rng([env.heap.seed, i]))
                rollout = roll_out(twin, twin.restore(snapshot), teacher.act, is_hopeless)
                # No success: a failed simulation must not be chosen for the penalties it escaped.
                behind = 0.0 if rollout.end == "uncovered" else WITHOUT_SUCCESS
                tried.append((score(rollout) - behind, np.array(rollout.actions, np.float32)))
                best = max(best, tried[-1][0])
        near = [actions for value, actions in tried if value >= best - config.tolerance]
        chosen = max(near, key=lambda actions: float(actions[0] @ towards))
        self._actions = list(chosen[::-1])
        self.simulated_actions = sum(len(actions) for _, actions in tried)

    def act(self, obs: Observation) -> NDArray[np.float32]:
        """Return the plan's next action (3,); stay in place once it is over."""
        return self._actions.pop() if self._actions else np.zeros(3, np.float32)


@runtime_checkable
class Equipped(Policy, Protocol):
    """A policy that retrieves, and must know with which grippers."""

    def equip(self, grippers: tuple[str, ...]) -> None:
        """Take the names of the robot's grippers, before the first episode.

        Raises:
            MechSearchError: If it cannot do with them.
        """


class ObservationWrapper:
    """A policy in the hands of a user: what it is handed is read and checked first.

    Attributes:
        policy: What acts. An evaluation asks it itself: what environments show can be read.
        keys: Observation keys that it reads.
        goal: What it is after; see `goal_of`.
        camera: View of its images, where it is bound to one.
        image_size: Their side [px], likewise.
    """

    def __init__(self, policy: Policy, run: Mapping[str, Any]) -> None:
        """Take a policy, and the configuration of the run that it comes from; empty for others."""
        self.policy, self.keys, self.goal = policy, policy.keys, goal_of(policy)
        view = _view_of(policy, run)
        self.camera, self.image_size = view.get("camera"), view.get("image_size")
        task = task_of(policy, run, TaskConfig.camera)
        self._workspace = task.workspace
        if isinstance(task, RetrievalTask):
            self.equip(task.grippers)

    def equip(self, grippers: tuple[str, ...]) -> None:
        """Take the names of the robot's grippers, if it retrieves."""
        if hasattr(self.policy, "equip"):
            self.policy.equip(grippers)

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode."""
        self.policy.reset(rng)

    def act(self, obs: Observation) -> Array:
        """Return the policy's action (3,), or decision (9,).

        Raises:
            MechSearchError: If the observation is not as `observe.observation.readable` expects.
        """
        seen = readable(obs, self.keys, self.image_size, self._workspace.clip)
        return self.policy.act(seen)


_MADE: dict[str, Callable[[], Policy]] = {
    "random": RandomPolicy, "idle": IdlePolicy, LOOK_AHEAD: LookAheadPolicy,
}  # fmt: skip


def policy_names() -> tuple[str, ...]:
    """Return the names of the built-in baselines, which plan nothing."""
    return ("random", "idle", *(f"teacher-{name}" for name in TEACHERS))


def make_policy(spec: str | Path) -> Policy:
    """Return the policy that a text names, for a robot or an environment.

    Those that are trained, teachers, and those that grasp are handed nothing that they cannot read:
    see `ObservationWrapper`. One that retrieves has the grippers of its training, or the
    usual one, until `equip` names others.

    Args:
        spec: "random", "idle", "look-ahead", or "teacher-" and a name in `teachers.TEACHERS`;
            one of `SHIPPED_POLICIES`; a run directory, whose last policy is meant, or one
            policy's file (.safetensors); or
            `package.module:factory`, a function without arguments, or a class, that returns a
            `mechsearch.types.Policy`.

    Raises:
        MechSearchError: If there is no such policy, or it cannot be made.
    """
    spec = str(spec)
    policy, own = policy_named(spec), is_entry_point(spec) and not _is_file_of_run(spec)
    # Some are the user's own, some read nothing, and some plan in the simulator.
    if own or spec in _MADE or hasattr(policy, "plan"):
        return policy
    return ObservationWrapper(policy, config_of_run(spec))


def policy_named(spec: str) -> Policy:
    """Return the policy that a text names, as it is; see `make_policy`."""
    if spec in _MADE:
        return _MADE[spec]()
    if spec.startswith("teacher-") and spec.removeprefix("teacher-") in TEACHERS:
        return make_teacher(spec.removeprefix("teacher-"))
    if spec in RETRIEVAL:
        _check_torch(f"the policy {spec}")
        return checked_policy(load_entry_point(RETRIEVAL[spec], "policy")(), spec)
    if spec in SHIPPED_POLICIES:
        return _trained(shipped_file(spec))
    if _is_file_of_run(spec):
        return _trained(Path(spec))
    if is_entry_point(spec):
        return checked_policy(called(load_entry_point(spec, "policy"), "policy", spec), spec)
    known = ", ".join((*policy_names(), LOOK_AHEAD, *SHIPPED_POLICIES, *RETRIEVAL))
    raise MechSearchError(
        f"unknown policy {spec!r}; choose one of {known}, a run "
        "directory, an actor's file (.safetensors), or package.module:factory"
    )


def shipped_file(name: str) -> Path:
    """Return the weights (.safetensors) of a shipped policy.

    Raises:
        MechSearchError: If there is none of that name.
    """
    if name not in SHIPPED_POLICIES:
        raise MechSearchError(
            f"no policy {name!r} is shipped; choose one of {', '.join(SHIPPED_POLICIES)}"
        )
    return _FOLDER / f"{name}.safetensors"


def card(name: str) -> dict[str, Any]:
    """Return a shipped policy's card: its data, configuration, seed and scores.

    Raises:
        MechSearchError: If there is none of that name, or the card is damaged.
    """
    found: dict[str, Any] = read_json(shipped_file(name).with_suffix(".json"), "policy's card")
    return found


def config_of_run(spec: str) -> Mapping[str, Any]:
    """Return the configuration of the run that a policy comes from; empty for others.

    A shipped policy goes by the name that it has on the command line.

    Raises:
        MechSearchError: If the configuration is damaged.
    """
    if spec in SHIPPED_POLICIES:
        return {**card(spec)["config"], "name": spec}
    if not _is_file_of_run(spec):
        return {}
    path = Path(spec)
    for folder in (path, path.parent, path.parent.parent):
        if (folder / CONFIG_FILE).is_file():
            return read_record(folder / CONFIG_FILE, "training configuration")
    return {}


def actor_of(spec: str) -> str | None:
    """Return the SHA-256 of the file that a trained policy is read from; None for others."""
    if spec in SHIPPED_POLICIES:
        file = shipped_file(spec)
    elif _is_file_of_run(spec):
        file = Path(spec) / POLICY_FILE if Path(spec).is_dir() else Path(spec)
    else:
        return None
    content = read_content(file)
    return None if content is None else hashlib.sha256(content).hexdigest()


def goal_of(policy: Policy) -> str:
    """Return what a policy is after, which says in which environment it acts.

    Returns:
        "uncover": it acts in a `HeapEnv`; or "retrieve": in a `RetrieveEnv`.

    Raises:
        MechSearchError: If it is after anything else.
    """
    goal = getattr(policy, "goal", UNCOVER)
    if goal not in (UNCOVER, RETRIEVE):
        raise MechSearchError(
            f"{type(policy).__name__} has the goal {goal!r}; choose one of {UNCOVER}, {RETRIEVE}"
        )
    return str(goal)


def task_of(policy: Policy, run: Mapping[str, Any], camera: str) -> TaskConfig:
    """Return the task that a policy is evaluated in where no other is asked for.

    It is a `RetrievalTask` of a policy that retrieves.

    Args:
        policy: Who acts.
        run: Configuration of the run that it comes from, in any version's layout; empty for others.
        camera: The heap set's view, for policies that are bound to none.

    Raises:
        MechSearchError: If the configuration is no good.
    """
    kind = RetrievalTask if goal_of(policy) == RETRIEVE else TaskConfig
    if "task" in run:
        return task_from_json(kind, run["task"])
    flat = {name: run[name] for name in _VIEW if name in run}
    return task_from_json(kind, {"camera": camera} | flat | _view_of(policy, run))


def check_view(policy: Policy, run: Mapping[str, Any], task: TaskConfig, name: str) -> None:
    """Refuse a task whose images are not of the kind that a policy sees through.

    A policy may say so by its attributes `camera` and `image_size` [px]; a trained one that reads
    images is bound to those of its run. Who reads no images acts in any task.

    Raises:
        MechSearchError: Naming both.
    """
    view = {"camera": task.camera, "image_size": task.image_size}
    bound = view | _view_of(policy, run)
    if bound != view:
        raise MechSearchError(
            f"{name} sees through the {bound['camera']} camera at {bound['image_size']} px; the "
            f"task has the {task.camera} camera at {task.image_size} px: choose the former, or "
            "another policy"
        )


def _view_of(policy: Policy, run: Mapping[str, Any]) -> dict[str, Any]:
    """Return the camera and the size of the images that a policy is bound to."""
    known = run.get("task", run) if IMAGE_KEYS & set(policy.keys) else {}
    said = {name: getattr(policy, name, None) for name in _VIEW}
    said = {name: value for name, value in said.items() if isinstance(value, _VIEW[name])}
    return {name: known[name] for name in _VIEW if name in known} | said


def _is_file_of_run(spec: str) -> bool:
    return spec.endswith(".safetensors") or (bool(spec) and Path(spec).is_dir())


def _trained(path: Path) -> Policy:
    if not path.exists():
        raise MechSearchError(f"no actor at {path}")
    _check_torch(f"the trained policy {path}")
    return checked_policy(load_entry_point(TRAINED_LOADER, "policy")(path), str(path))


def _check_torch(who: str) -> None:
    check_extra(who, "learn")
    # Other numbers of threads give other bits, and scores must not depend on the workers.
    importlib.import_module("torch").set_num_threads(1)


def checked_policy(policy: object, spec: str) -> Policy:
    """Return a policy that a text, or a user, gave.

    Raises:
        MechSearchError: If it is none, naming what it lacks.
    """
    known: Policy = conforming(policy, "policy", spec, ("keys", "reset(rng)", "act(obs)"))
    return known
