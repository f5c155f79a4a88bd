"""The task as a record: what is seen, rewarded and possible."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from math import inf, isfinite
from numbers import Real
from operator import attrgetter
from typing import Any, Self, TypeVar

from mechsearch.camera import Camera, mounted, preset
from mechsearch.env.reward import RewardConfig
from mechsearch.files import check_kinds, record_from_json
from mechsearch.grippers import GRIPPERS, Gripper, gripper_named
from mechsearch.observe.sensor import Sensor, SensorMixture, sensor_named
from mechsearch.segmentation.segmenter import (
    NEVER,
    TRUE,
    Judge,
    TargetFinder,
    check_segmenter,
    check_stop,
)
from mechsearch.sim import (
    ENGINES,
    FREE,
    PhysicsConfig,
    Pusher,
    Workspace,
    arm_named,
)
from mechsearch.types import ACTOR_KEYS, PRIVILEGED_KEYS, RETRIEVAL_KEYS, MechSearchError, shown

_LEAST = {
    "max_actions": 1, "start_distance": 0, "uncovered_at": 0, "physics.action_steps": 1,
    "physics.rest_steps": 0, "physics.solver_iterations": 1, "physics.sleep_speed": 0,
    "physics.clearance": 0, "physics.still_speed": 0, "physics.still_spin": 0, "workspace.low": 0,
    "pusher.friction": 0,
}  # fmt: skip
_ABOVE_0 = (
    "physics.time_step", "physics.deep_penetration", "physics.explosion_speed", "workspace.half",
    "workspace.table_half", "pusher.radius", "pusher.mass", "pusher.stiffness", "pusher.force",
)  # fmt: skip
_SHOWN = ("keys", "privileged", "max_clutter")
_OF_MUJOCO = (
    "physics.solver_iterations", "physics.contact_time", "physics.contact_impedance",
    "physics.sleep_speed", "physics.clearance", "physics.still_speed", "physics.still_spin",
    "physics.stops_when_still", "pusher.stiffness",
)  # fmt: skip
_MAY_BE_INFINITE = ("physics.clearance", "physics.deep_penetration", "physics.explosion_speed")


@dataclass(frozen=True)
class TaskConfig:
    """The task: what is seen, rewarded and possible, whatever the heaps and whoever acts.

    Attributes:
        camera: View of all images and of occlusion: "overhead" or "tilted".
        image_size: Side of the square images [px].
        mounted: Where the camera really is that these images are reprojected from: degrees off the
            vertical, metres from the table's middle, and its image [px], such as "35 0.9 640x480";
            by default in that view itself.
        sensor: How well is seen: "perfect", "stereo", "time-of-flight" or "harsh", and what of it
            is otherwise, such as "stereo camera_turn=1 mask_shift=0".
        segmenter: What finds the target's visible part: "true", the simulator itself; "shipped", a
            network; a network's file; or package.module:factory.
        stop: Who ends an episode because the target is uncovered: "true", the simulator; "shipped",
            a network that estimates from images what is hidden; a network's file; or "never".
        max_actions: Length of an episode (paper: 50).
        uncovered_at: Occlusion up to which the target counts as completely visible.
        start_distance: Least distance from start to target [m] (paper: 0.2).
        reward: Terms and weights of the reward.
        physics: Numerical choices.
        workspace: Table and bounds.
        pusher: The end effector.
        engine: What computes the physics: "mujoco", or "bullet" for pushes alone, which takes of
            `physics` the times of an action and what counts as a failure.
        robot: What moves it: "free", nothing that is seen or met; "ur5e" or "panda", an arm that
            refuses what it cannot do, and takes as long as it needs.
    """

    camera: str = "overhead"
    image_size: int = 64
    mounted: str = ""
    sensor: str = "perfect"
    segmenter: str = TRUE
    stop: str = TRUE
    max_actions: int = 50
    uncovered_at: float = 0.02
    start_distance: float = 0.2
    reward: RewardConfig = field(default_factory=RewardConfig)
    physics: PhysicsConfig = field(default_factory=PhysicsConfig)
    workspace: Workspace = field(default_factory=Workspace)
    pusher: Pusher = field(default_factory=Pusher)
    engine: str = ENGINES[0]
    robot: str = FREE

    def __post_init__(self) -> None:
        check_kinds(self)
        preset(self.camera, self.image_size)
        _ = self.mount
        sensor_named(self.sensor)
        check_segmenter(self.segmenter)
        check_stop(self.stop)
        arm_named(self.robot)
        physics, workspace, pusher = self.physics, self.workspace, self.pusher
        least = _LEAST | {"physics.contact_time": 2 * physics.time_step}
        bounds = {"workspace.high": workspace.low, "pusher.length": 2 * pusher.radius}
        more = dict.fromkeys(_ABOVE_0, 0) | bounds
        shares = [0 < share < 1 for share in physics.contact_impedance]

        def at(name: str) -> Any:
            return attrgetter(name)(self)

        rules = [
            *((name, at(name) >= bound, f"at least {bound}") for name, bound in least.items()),
            *((name, at(name) > bound, f"more than {bound}") for name, bound in more.items()),
            ("uncovered_at", self.uncovered_at < 1, "less than 1"),
            ("physics.contact_impedance", shares == [True] * 2, "two shares between 0 and 1"),
            ("workspace.floor", workspace.floor <= 0, "at most 0, the table's height"),
        ]
        if self.engine not in ENGINES:
            raise MechSearchError(
                f"unknown engine {self.engine!r}; choose one of {', '.join(ENGINES)}"
            )
        if self.engine != ENGINES[0]:
            if self.robot != FREE:
                raise MechSearchError(
                    f"robot is {self.robot!r}; expected {FREE!r}, as {self.engine} moves no arm"
                )
            for name in _OF_MUJOCO:
                usual = attrgetter(name)(TaskConfig())
                rules.append((name, at(name) == usual, f"{usual}, {self.engine} has its own"))
        for name, holds, expected in rules:
            if not holds or (at(name) in (inf, -inf) and name not in _MAY_BE_INFINITE):
                raise MechSearchError(f"{name} is {at(name)}; expected {expected}")

    @property
    def mount(self) -> Camera | None:
        """The camera that `mounted` says; None where images are taken in the view itself."""
        return mounted(self.mounted, self.camera) if self.mounted else None

    @property
    def sees(self) -> Sensor | SensorMixture:
        """What `sensor` names."""
        return sensor_named(self.sensor)

    @property
    def finder(self) -> TargetFinder | None:
        """A new one of what `segmenter` names; None of the simulator's own masks."""
        return None if self.segmenter == TRUE else TargetFinder(self.segmenter, self.camera)

    @property
    def simulator_stops(self) -> bool:
        """Whether the simulator ends an episode because the target is uncovered."""
        return self.stop == TRUE

    @property
    def judge(self) -> Judge | None:
        """A new one of what `stop` names; None where no image is asked."""
        return None if self.stop in (TRUE, NEVER) else Judge(self.stop, self.camera)


@dataclass(frozen=True)
class HeapEnvConfig(TaskConfig):
    """The task, and what an environment shows of it.

    Attributes:
        keys: Observation keys; see `types`.
        privileged: Whether to add the keys that critic and teachers read.
        max_clutter: Entries of the padded clutter offsets; 0 takes the largest heap's.
    """

    keys: tuple[str, ...] = ACTOR_KEYS
    privileged: bool = False
    max_clutter: int = 0

    @classmethod
    def of_task(cls, task: TaskConfig, keys: Sequence[str], privileged: bool = False) -> Self:
        """Return the configuration that shows some keys of a task."""
        names = [f.name for f in fields(cls) if f.name not in _SHOWN and hasattr(task, f.name)]
        shared = {name: getattr(task, name) for name in names}
        return cls(**shared, keys=tuple(keys), privileged=privileged)

    @property
    def all_keys(self) -> tuple[str, ...]:
        """The observation's keys, privileged ones included where asked for."""
        extra = PRIVILEGED_KEYS if self.privileged else ()
        return (*self.keys, *(key for key in extra if key not in self.keys))


@dataclass(frozen=True)
class RetrievalReward:
    """Weights of the reward's terms.

    Attributes:
        retrieved: For the target in the hand.
        action: Cost of each decision.
        movement: Cost of each metre that the mean non-target object moves.
    """

    retrieved: float = 1.0
    action: float = 0.01
    movement: float = 1.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not isinstance(value, Real) or not isfinite(value):
                raise MechSearchError(
                    f"retrieval.{name} is {shown(value)}; expected a finite number"
                )


@dataclass(frozen=True)
class RetrievalTask(TaskConfig):
    """The task of retrieval: the target in the hand.

    `uncovered_at` and `reward` are about pushing alone and mean nothing here.

    Attributes:
        grippers: Names of the robot's grippers; the first one, closed, pushes.
        max_grasps: Grasps of the target in an episode.
        max_removals: Removals of other objects in an episode.
        perturbed: Whether each grasp is off by what the lift test calls uncertain; the draws depend
            on the heap's seed and the number of the attempt alone.
        retrieval: Weights of the reward.
    """

    grippers: tuple[str, ...] = ("jaws-85",)
    max_grasps: int = 8
    max_removals: int = 8
    perturbed: bool = False
    retrieval: RetrievalReward = field(default_factory=RetrievalReward)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.grippers or len(set(self.grippers)) < len(self.grippers):
            raise MechSearchError(
                f"grippers are {', '.join(self.grippers) or 'none'}; expected one or more, no two "
                "alike"
            )
        for name in self.grippers:
            gripper_named(name)
        for name, least in (("max_grasps", 1), ("max_removals", 0)):
            if getattr(self, name) < least:
                raise MechSearchError(f"{name} is {getattr(self, name)}; expected at least {least}")
        if self.engine != ENGINES[0]:
            raise MechSearchError(
                f"engine is {self.engine!r}; grippers are simulated by {ENGINES[0]} alone"
            )
        if self.segmenter != TRUE:
            raise MechSearchError(
                f"segmenter is {self.segmenter!r}; grasps are planned on masks of all objects, "
                f"which only {TRUE!r} has"
            )
        if self.mounted:
            raise MechSearchError(
                f"mounted is {self.mounted!r}; expected nothing: grasps are planned on images from "
                "above"
            )
        if self.stop != TRUE:
            raise MechSearchError(
                f"stop is {self.stop!r}; expected {TRUE!r}: retrieval ends with the target in "
                "the hand"
            )
        jaws = [name for name, each in GRIPPERS.items() if isinstance(each, Gripper)]
        if self.robot != FREE and (len(self.grippers) > 1 or self.grippers[0] not in jaws):
            raise MechSearchError(
                f"grippers are {', '.join(self.grippers)}; the arm {self.robot} holds one of "
                f"{', '.join(jaws)}"
            )
        if self.pusher != Pusher():
            raise MechSearchError(
                f"a pusher of its own, {self.pusher}; in retrieval the first of the grippers pushes"
            )


@dataclass(frozen=True)
class RetrieveConfig(HeapEnvConfig, RetrievalTask):
    """The task of retrieval, and what an environment shows of it; see `HeapEnvConfig`."""

    keys: tuple[str, ...] = RETRIEVAL_KEYS


Task = TypeVar("Task", bound=TaskConfig)


def task_from_json(kind: type[Task], data: Mapping[str, Any]) -> Task:
    """Return the task that `dataclasses.asdict` and JSON made, of this or an earlier version.

    Args:
        kind: A task, or a task with what an environment shows of it.
        data: Values by field.

    Raises:
        MechSearchError: If a field is unknown, or its value is one that this version has not.
    """
    reward = data.get("reward")
    if isinstance(reward, Mapping) and "least_occlusion" in reward:
        uncovered_at = data.get("uncovered_at", kind.uncovered_at)
        if reward["least_occlusion"] != uncovered_at:
            raise MechSearchError(
                f"reward.least_occlusion is {reward['least_occlusion']}, and uncovered_at "
                f"{uncovered_at}; this version has one number, uncovered_at, for both: use the "
                "version that wrote it"
            )
        data = {**data, "reward": {k: v for k, v in reward.items() if k != "least_occlusion"}}
    return record_from_json(kind, data)


def with_settings(
    kind: type[Task], task: Task | None, camera: str, settings: Mapping[str, Any]
) -> Task:
    """Return a task with some fields replaced.

    Args:
        kind: What it must be.
        task: The task; None takes the default one through `camera`.
        camera: View, where there is no task.
        settings: Values by field.

    Raises:
        MechSearchError: If it is no such task, there is no such field, or a value is no good.
    """
    task = kind(camera=camera) if task is None else task
    if not isinstance(task, kind):
        raise MechSearchError(f"config is {shown(task)}; expected a {kind.__name__}")
    known = [entry.name for entry in fields(kind)]
    unknown = [key for key in settings if key not in known]
    if unknown:
        raise MechSearchError(f"unknown setting {unknown[0]!r}; choose among {', '.join(known)}")
    return replace(task, **settings)
