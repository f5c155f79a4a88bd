"""The decision process: nudge a heap until its target is uncovered (paper, section III-A)."""

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from math import inf, isfinite
from operator import attrgetter
from pathlib import Path
from typing import Any, Self, TypeVar

import gymnasium
import numpy as np

from mechsearch.camera import preset
from mechsearch.env.reward import RewardConfig, reward_of
from mechsearch.files import record_from_json
from mechsearch.geometry import cap_length
from mechsearch.heaps.dataset import Heap, embedded_file, open_heaps
from mechsearch.objects.model import ObjectSet
from mechsearch.observe.observation import Observer, Scene, others
from mechsearch.render.renderer import Frame, Renderer
from mechsearch.sim.scene import PhysicsConfig, Pusher, Workspace, pusher_model
from mechsearch.sim.world import World
from mechsearch.types import (
    ACTION_LENGTH,
    ACTOR_KEYS,
    PRIVILEGED_KEYS,
    Array,
    Floats,
    MechSearchError,
)

_WORLDS_KEPT = 8

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
_MAY_BE_INFINITE = ("physics.clearance", "physics.deep_penetration", "physics.explosion_speed")


@dataclass(frozen=True)
class TaskConfig:
    """The task: what is seen, rewarded and possible, whatever the heaps and whoever acts.

    Attributes:
        camera: View of all images and of occlusion: "overhead" or "tilted".
        image_size: Side of the square images [px].
        max_actions: Length of an episode (paper: 50).
        uncovered_at: Occlusion up to which the target counts as completely visible.
        start_distance: Least distance from start to target [m] (paper: 0.2).
        reward: Terms and weights of the reward.
        physics: Numerical choices.
        workspace: Table and bounds.
        pusher: The end effector.
    """

    camera: str = "overhead"
    image_size: int = 64
    max_actions: int = 50
    uncovered_at: float = 0.02
    start_distance: float = 0.2
    reward: RewardConfig = field(default_factory=RewardConfig)
    physics: PhysicsConfig = field(default_factory=PhysicsConfig)
    workspace: Workspace = field(default_factory=Workspace)
    pusher: Pusher = field(default_factory=Pusher)

    def __post_init__(self) -> None:
        preset(self.camera, self.image_size)
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
        for name, holds, expected in rules:
            if not holds or (at(name) in (inf, -inf) and name not in _MAY_BE_INFINITE):
                raise MechSearchError(f"{name} is {at(name)}; expected {expected}")


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
        shared = {entry.name: getattr(task, entry.name) for entry in fields(TaskConfig)}
        return cls(**shared, keys=tuple(keys), privileged=privileged)

    @property
    def all_keys(self) -> tuple[str, ...]:
        """The observation's keys, privileged ones included where asked for."""
        extra = PRIVILEGED_KEYS if self.privileged else ()
        return (*self.keys, *(key for key in extra if key not in self.keys))


Task = TypeVar("Task", bound=TaskConfig)


def task_from_json(kind: type[Task], data: Mapping[str, Any]) -> Task:
    """Return the task that `dataclasses.asdict` and JSON made, of this or an earlier version.

    Args:
        kind: `TaskConfig` or `HeapEnvConfig`.
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


@dataclass(frozen=True)
class HeapState:
    """The true state, for records and pictures; no policy sees it.

    Attributes:
        poses: Of all objects (N, 7).
        ee_position: End effector (3,) [m].
        occlusion: Of the target, in [0, 1]; 1 when it is lost.
    """

    poses: Floats
    ee_position: Floats
    occlusion: float


class HeapEnv(gymnasium.Env[Any, Array]):
    """Episodes over a list of heaps.

    `reset(options=...)` takes `heap`, the index of the heap, and `fixed_start`, whether the end
    effector starts where this heap's own seed says, so that all policies start alike.
    `info` holds `reward_terms`, `occlusion`, `end` (None while the episode goes on, else
    "uncovered", "action limit", "lost" or "failure: ..."), `failure` (a simulator failure's name or
    None: such a transition must not be learnt from), `clutter_moved` (mean displacement of the
    non-target objects in this action [m]) and `target_moved` [m].
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 5}  # noqa: RUF012

    def __init__(
        self,
        heaps: Sequence[Heap],
        objects: ObjectSet,
        config: HeapEnvConfig | None = None,
        render_mode: str | None = None,
    ) -> None:
        """Prepare the task; nothing is simulated yet.

        Args:
            heaps: Start states.
            objects: The set that the heaps' names refer to.
            config: The task.
            render_mode: "rgb_array" or None.

        Raises:
            MechSearchError: If there is no heap, one names an unknown object, or the reward's
                function is no good.
        """
        self.config = config or HeapEnvConfig()
        self.heaps = tuple(heaps)
        self.objects = objects
        self.render_mode = render_mode
        if not self.heaps:
            raise MechSearchError("an environment needs at least one heap; got none")
        missing = sorted({n for h in heaps for n in h.objects if n not in objects.models})
        if missing:
            raise MechSearchError(
                f"object set {objects.name!r} lacks {', '.join(missing[:5])}; the heaps were made "
                "with another set"
            )
        largest = max(len(heap.objects) for heap in heaps) - 1
        if self.config.max_clutter != 0 and self.config.max_clutter < largest:
            raise MechSearchError(
                f"max_clutter is {self.config.max_clutter}, but a heap has {largest} non-target "
                f"objects; expected at least {largest}, or 0 to fit"
            )
        self._reward, terms = reward_of(self.config.reward)
        self.no_reward = dict.fromkeys(terms, 0.0)
        self._labels = {name: i for i, name in enumerate(objects.models)}
        self._observer = Observer(
            self.config.all_keys,
            preset(self.config.camera, self.config.image_size),
            self.config.max_clutter or largest,
            len(self._labels),
            reach=2.0,
        )
        self.observation_space = self._observer.space
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (3,), np.float32)
        # Occlusion is measured from the standard view, whatever the policy's image size.
        self._camera = preset(self.config.camera)
        self._worlds: OrderedDict[int, tuple[World, Renderer]] = OrderedDict()
        self._heap_index = -1

    @property
    def heap(self) -> Heap:
        """The heap of the current episode.

        Raises:
            MechSearchError: If none has begun.
        """
        if self._heap_index < 0:
            raise MechSearchError("no episode has begun; call reset first")
        return self.heaps[self._heap_index]

    @property
    def world(self) -> World:
        """The physics of the current episode, for measurements; stepping it is cheating."""
        _ = self.heap
        return self._world

    @property
    def state(self) -> HeapState:
        """The true state."""
        position = self.world.pusher_position
        return HeapState(self._poses.copy(), position, self._occlusion)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Array], dict[str, Any]]:
        """Start an episode."""
        super().reset(seed=seed)
        options = options or {}
        index = options.get("heap")
        if index is None:
            index = int(self.np_random.integers(len(self.heaps)))
        if not 0 <= index < len(self.heaps):
            raise MechSearchError(f"heap {index} does not exist; choose 0 to {len(self.heaps) - 1}")
        self._heap_index = index
        heap = self.heap
        fixed = options.get("fixed_start", False)
        rng = np.random.default_rng([heap.seed, 1]) if fixed else self.np_random
        self._world, self._renderer = self._scene_of(index)
        self._world.reset(heap.poses, self._sample_start(rng))
        self._poses = self._world.poses
        self._present = np.ones(len(heap.objects), np.bool_)
        self._occlusion = self._measure_occlusion()
        self._actions = 0
        self._over = False
        return self._observe(), {"occlusion": self._occlusion, "heap": index}

    def step(self, action: Array) -> tuple[dict[str, Array], float, bool, bool, dict[str, Any]]:
        """Execute one action.

        Raises:
            MechSearchError: If the action is malformed, or the episode is over.
        """
        offset = _displacement(action)
        if self._heap_index < 0 or self._over:
            raise MechSearchError("the episode is over; call reset before the next step")
        command = self._world.pusher_position + offset
        target = self.config.workspace.clip(command)
        before, poses, present = self._occlusion, self._poses, self._present
        simulated = self._world.push(target)
        self._actions += 1
        moved = np.zeros(len(poses))
        if simulated:
            failure = self._world.failure()
            if failure is not None:
                # The last trusted state is shown, and no reward given.
                self._world.reset(self._poses)
                return self._result(
                    self.no_reward, np.zeros(1), 0.0, f"failure: {failure}", failure
                )
            self._update_poses()
            way = self._poses[:, :3] - poses[:, :3]
            moved = np.sqrt((way * way).sum(axis=1)) * present
            if (self._poses != poses).any():
                self._occlusion = self._measure_occlusion()
        own = self.heap.target
        clutter, target_moved = moved[others(own, len(moved))], float(moved[own])
        reward = self._reward(
            before, self._occlusion, clutter, target_moved,
            max(map(abs, (command - target).tolist())) > 1e-9, self.config.uncovered_at,
            self.config.reward,
        )  # fmt: skip
        end = None
        if not self._present[own]:
            end = "lost"
        elif self._occlusion <= self.config.uncovered_at:
            end = "uncovered"
        elif self._actions >= self.config.max_actions:
            end = "action limit"
        return self._result(reward, clutter, target_moved, end)

    def render(self) -> Array | None:
        """Return a colour picture (256, 256, 3) uint8, when made with render_mode="rgb_array"."""
        if self.render_mode != "rgb_array":
            return None
        _ = self.heap
        return self._frame(256, colour=True).rgb

    def snapshot(self) -> dict[str, Array]:
        """Return all that the rest of the episode depends on, as arrays."""
        return {
            "heap": np.array(self._heap_index),
            "world": self.world.snapshot(),
            "poses": self._poses.copy(),
            "present": self._present.copy(),
            "occlusion": np.array(self._occlusion),
            "actions": np.array(self._actions),
            "over": np.array(self._over),
        }

    def restore(self, snapshot: dict[str, Array]) -> dict[str, Array]:
        """Return to a snapshot, exactly; return its observation."""
        self._heap_index = int(snapshot["heap"])
        self._world, self._renderer = self._scene_of(self._heap_index)
        self._world.restore(snapshot["world"])
        self._poses = np.array(snapshot["poses"])
        self._present = np.array(snapshot["present"])
        self._occlusion = float(snapshot["occlusion"])
        self._actions = int(snapshot["actions"])
        self._over = bool(snapshot["over"])
        return self._observe()

    def _scene_of(self, index: int) -> tuple[World, Renderer]:
        if index in self._worlds:
            self._worlds.move_to_end(index)
            return self._worlds[index]
        config = self.config
        models = [self.objects.models[name] for name in self.heaps[index].objects]
        world = World(models, config.workspace, config.pusher, config=config.physics)
        renderer = Renderer(
            models, pusher_model(config.pusher), config.workspace.table_half, config.workspace.floor
        )
        self._worlds[index] = world, renderer
        if len(self._worlds) > _WORLDS_KEPT:
            self._worlds.popitem(last=False)
        return world, renderer

    def _sample_start(self, rng: np.random.Generator) -> Floats:
        """Return a contact-free position, uniform over the workspace, away from the target."""
        heap = self.heap
        centre = heap.poses[heap.target, :3]
        for _ in range(1000):
            position = self.config.workspace.sample(rng)
            if np.linalg.norm(position - centre) < self.config.start_distance:
                continue
            self._world.reset(heap.poses, position)
            if self._world.pusher_is_free():
                return position
        raise MechSearchError(
            f"heap {heap.seed} leaves no room for a start at least "
            f"{self.config.start_distance} m from its target"
        )

    def _update_poses(self) -> None:
        """Take the objects' new poses; those that left the table stay where they left it."""
        poses = self._world.poses
        if not self._present.all():
            poses[~self._present] = self._poses[~self._present]
        gone = self._present & self.config.workspace.off_table(poses)
        if gone.any():
            for index in np.flatnonzero(gone):
                self._world.remove(int(index))
            self._present = self._present & ~gone
        self._poses = poses

    def _measure_occlusion(self) -> float:
        if not self._present[self.heap.target]:
            return 1.0
        return self._renderer.occlusion(
            self._camera, self._poses, self.heap.target, self._present, self._pusher_pose()
        )

    def _pusher_pose(self) -> Floats:
        return self.config.pusher.pose(self._world.pusher_position)

    def _frame(self, size: int, colour: bool) -> Frame:
        camera = preset(self.config.camera, size)
        return self._renderer.frame(camera, self._poses, self._pusher_pose(), colour)

    def _observe(self) -> dict[str, Array]:
        heap, depth, mask, rgb = self.heap, None, None, None
        if self._observer.needs_images:
            frame = self._frame(self.config.image_size, self._observer.needs_colour)
            depth, mask, rgb = frame.depth, frame.modal(heap.target), frame.rgb
        return self._observer.observe(
            Scene(
                depth=depth,
                target_mask=mask,
                rgb=rgb,
                ee_position=self._world.pusher_position,
                positions=self._poses[:, :3],
                present=self._present,
                target=heap.target,
                label=self._labels[heap.objects[heap.target]],
            )
        )

    def _result(
        self,
        reward: Mapping[str, float],
        clutter: Array,
        target_moved: float,
        end: str | None,
        failure: str | None = None,
    ) -> tuple[dict[str, Array], float, bool, bool, dict[str, Any]]:
        self._over, terminated = end is not None, end in ("lost", "uncovered")
        info = {
            "reward_terms": dict(reward),
            "occlusion": self._occlusion,
            "end": end,
            "failure": failure,
            "clutter_moved": float(clutter.sum()) / max(len(clutter), 1),
            "target_moved": target_moved,
        }
        truncated = self._over and not terminated
        return self._observe(), float(sum(reward.values())), terminated, truncated, info


def _displacement(action: Array) -> Floats:
    """Return the commanded displacement (3,) [m] of an action, at most 5 cm long.

    Raises:
        MechSearchError: If the action has another shape or is not finite.
    """
    values = np.asarray(action, np.float64)
    if values.shape != (3,):
        raise MechSearchError(f"an action has shape (3,), in [-1, 1]; got shape {values.shape}")
    numbers = values.tolist()
    if not all(map(isfinite, numbers)):
        raise MechSearchError(f"an action is three finite numbers in [-1, 1]; got {values}")
    return cap_length([min(max(n, -1.0), 1.0) * ACTION_LENGTH for n in numbers], ACTION_LENGTH)


def make_env(
    condition: str = "single",
    heaps: str | Path | None = None,
    objects: str = "household",
    split: str = "train",
    config: HeapEnvConfig | None = None,
    render_mode: str | None = None,
    **settings: Any,
) -> HeapEnv:
    """Return an environment.

    Args:
        condition: "single" or "dual"; chooses among the embedded heaps.
        heaps: Heap set file; None takes the embedded heaps of household objects.
        objects: Object set that the heaps were made with.
        split: "held-out", "train" or "all" of the heaps.
        config: The task.
        render_mode: "rgb_array" or None.
        settings: Fields of the configuration to replace, such as `privileged=True`.

    Raises:
        MechSearchError: If a name or setting is unknown, or heaps and objects do not fit.
    """
    file = embedded_file(condition) if heaps is None else Path(heaps)
    heap_set, object_set = open_heaps(file, objects)
    chosen = [heap_set.heaps[i] for i in heap_set.choose(split)]
    base = config or HeapEnvConfig(camera=heap_set.camera)
    unknown = [key for key in settings if key not in base.__dataclass_fields__]
    if unknown:
        raise MechSearchError(
            f"unknown setting {unknown[0]!r}; choose among {', '.join(base.__dataclass_fields__)}"
        )
    return HeapEnv(chosen, object_set, replace(base, **settings), render_mode)
