"""The decision process: nudge a heap until its target is uncovered (paper, section III-A)."""

from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from math import inf, isfinite
from operator import attrgetter
from typing import Any, Self, TypeVar

import gymnasium
import numpy as np

from mechsearch.camera import preset
from mechsearch.env.reward import RewardConfig, reward_of
from mechsearch.files import record_from_json
from mechsearch.geometry import cap_length
from mechsearch.heaps.heap import Heap
from mechsearch.objects.model import ObjectSet
from mechsearch.observe.observation import Observer, Scene, others
from mechsearch.render.renderer import Frame, Renderer
from mechsearch.render.visibility import occlusion
from mechsearch.sim.pusher import Pusher, pusher_model
from mechsearch.sim.scene import PhysicsConfig
from mechsearch.sim.workspace import Workspace
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


_LEAST = (
    ("max_actions", 1), ("start_distance", 0), ("uncovered_at", 0), ("physics.action_steps", 1),
    ("physics.rest_steps", 0), ("physics.solver_iterations", 1), ("physics.sleep_speed", 0),
    ("physics.clearance", 0), ("physics.still_speed", 0), ("physics.still_spin", 0),
    ("workspace.low", 0), ("pusher.friction", 0),
)  # fmt: skip
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
        shares = [0 < share < 1 for share in physics.contact_impedance]
        rules = [
            *((name, _at(self, name) >= least, f"at least {least}") for name, least in _LEAST),
            *((name, _at(self, name) > 0, "more than 0") for name in _ABOVE_0),
            ("uncovered_at", self.uncovered_at < 1, "less than 1"),
            (
                "physics.contact_time",
                physics.contact_time >= 2 * physics.time_step,
                f"two steps of {physics.time_step} s or more",
            ),
            ("physics.contact_impedance", shares == [True] * 2, "two shares between 0 and 1"),
            ("workspace.high", workspace.high > workspace.low, f"more than {workspace.low}"),
            ("workspace.floor", workspace.floor <= 0, "at most 0, the table's height"),
            ("pusher.length", pusher.length > 2 * pusher.radius, f"more than {2 * pusher.radius}"),
        ]
        for name, holds, expected in rules:
            value = _at(self, name)
            if not holds or (value in (inf, -inf) and name not in _MAY_BE_INFINITE):
                raise MechSearchError(f"{name} is {value}; expected {expected}")


def _at(task: "TaskConfig", name: str) -> Any:
    return attrgetter(name)(task)


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


def differing(one: TaskConfig, other: TaskConfig) -> tuple[str, ...]:
    """Return in what another task differs from one, such as "reward.movement 75 -> 100"."""
    return tuple(_differing(one, other, TaskConfig, ""))


def _differing(one: Any, other: Any, kind: Any, prefix: str) -> Iterator[str]:
    for entry in fields(kind):
        name, before = prefix + entry.name, getattr(one, entry.name)
        now = getattr(other, entry.name)
        if is_dataclass(before):
            yield from _differing(before, now, before, f"{name}.")
        elif before != now:
            yield f"{name} {str(before).removesuffix('.0')} -> {str(now).removesuffix('.0')}"


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

    @property
    def actions_taken(self) -> int:
        """Actions in the current episode so far."""
        return self._actions

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
                return self._end_of_failure(failure)
            self._update_poses()
            way = self._poses[:, :3] - poses[:, :3]
            moved = np.sqrt((way * way).sum(axis=1)) * present
            if (self._poses != poses).any():
                self._occlusion = self._measure_occlusion()
        clutter = moved[others(self.heap.target, len(moved))]
        reward = self._reward(
            before, self._occlusion, clutter, float(moved[self.heap.target]),
            max(map(abs, (command - target).tolist())) > 1e-9, self.config.uncovered_at,
            self.config.reward,
        )  # fmt: skip
        lost = not self._present[self.heap.target]
        uncovered = not lost and self._occlusion <= self.config.uncovered_at
        out_of_actions = self._actions >= self.config.max_actions
        terminated, truncated = lost or uncovered, out_of_actions and not (lost or uncovered)
        end = (
            "lost" if lost else "uncovered" if uncovered else "action limit" if truncated else None
        )
        self._over = end is not None
        info = self._info(reward, clutter, float(moved[self.heap.target]), end, None)
        return self._observe(), float(sum(reward.values())), terminated, truncated, info

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
        projection = self._renderer.projection(self._camera)
        # The frame that follows shows the pusher too: placing both at once is cheaper.
        projection.place(np.concatenate([self._poses, self._pusher_pose()[None]]))
        return occlusion(
            self._renderer.bodies, self._camera, self._poses, self.heap.target,
            present=self._present, projection=projection,
        )  # fmt: skip

    def _pusher_pose(self) -> Floats:
        return self.config.pusher.pose(self._world.pusher_position)

    def _frame(self, size: int, colour: bool) -> Frame:
        camera = preset(self.config.camera, size)
        return self._renderer.frame(camera, self._poses, self._pusher_pose(), colour)

    def _observe(self) -> dict[str, Array]:
        frame = (
            self._frame(self.config.image_size, self._observer.needs_colour)
            if self._observer.needs_images
            else None
        )
        heap = self.heap
        return self._observer.observe(
            Scene(
                depth=None if frame is None else frame.depth,
                target_mask=None if frame is None else frame.modal(heap.target),
                rgb=None if frame is None else frame.rgb,
                ee_position=self._world.pusher_position,
                positions=self._poses[:, :3],
                present=self._present,
                target=heap.target,
                label=self._labels[heap.objects[heap.target]],
            )
        )

    def _end_of_failure(
        self, failure: str
    ) -> tuple[dict[str, Array], float, bool, bool, dict[str, Any]]:
        """End the episode as truncated; the last trusted state is shown and no reward given."""
        self._over = True
        self._world.reset(self._poses)
        info = self._info(self.no_reward, np.zeros(1), 0.0, f"failure: {failure}", failure)
        return self._observe(), 0.0, False, True, info

    def _info(
        self,
        reward: Mapping[str, float],
        clutter: Array,
        target_moved: float,
        end: str | None,
        failure: str | None,
    ) -> dict[str, Any]:
        return {
            "reward_terms": dict(reward),
            "occlusion": self._occlusion,
            "end": end,
            "failure": failure,
            "clutter_moved": float(clutter.sum()) / max(len(clutter), 1),
            "target_moved": target_moved,
        }


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
