"""The heap that an environment shows: physics, true poses, occlusion, images, observations."""

from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from os import PathLike
from pathlib import Path
from typing import Any, Generic, NoReturn, TypeVar, cast

import gymnasium
import numpy as np

from mechsearch.camera import Camera, preset
from mechsearch.env.task import HeapEnvConfig
from mechsearch.geometry import cap_length
from mechsearch.heaps.dataset import Heap, embedded_file, open_heaps
from mechsearch.objects.model import ObjectModel, ObjectSet
from mechsearch.observe.binning import binned
from mechsearch.observe.observation import Observer, OnDemand, Scene, others, without_holes
from mechsearch.observe.reprojection import reproject
from mechsearch.render.renderer import Frame, Renderer
from mechsearch.sim import HeapWorld
from mechsearch.types import (
    ACTION_LENGTH,
    IMAGE_KEYS,
    Array,
    Floats,
    MechSearchError,
    Observation,
    finite_numbers,
    real_array,
    shown,
)

_FINE = 256
"""Side of the sensor's image that a policy's is made of [px], about."""

_WORLDS_KEPT = 8

_ACTION = "an action is (3,) finite numbers in [-1, 1]"

_TRAY_AWAY = 0.2
"""Between the table and the tray beside it, out of every camera's view [m]."""

_HOLE = 1000
"""What holes are marked by, beside numbers of masks."""

_SAVED = ("heap", "world", "poses", "present", "occlusion")

W = TypeVar("W", bound=HeapWorld)


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


class HeapScene(Generic[W]):
    """One heap at a time, as physics and cameras have it; what it means is the environment's.

    Attributes:
        observer: Makes the observations, and knows their space.
        judge: Estimates from images what is hidden; None where the task asks for no estimate.
        camera: From which occlusion is measured.
        world: The physics.
        renderer: Of its objects and the end effector.
        poses: Of all objects (N, 7); those that left the table keep their last ones.
        present: Which objects are still on the table (N,).
        occlusion: Of the target, in [0, 1].
        moved: How far the last action has moved each object (N,) [m].
    """

    world: W
    renderer: Renderer
    poses: Floats
    present: Array
    occlusion: float
    moved: Floats

    def __init__(
        self,
        heaps: Sequence[Heap],
        objects: ObjectSet,
        config: HeapEnvConfig,
        keys: Sequence[str],
        world_of: Callable[[Sequence[ObjectModel]], W],
        effector: ObjectModel,
        robot_in_view: bool = True,
    ) -> None:
        """Prepare for a list of heaps; none is on the table yet.

        Args:
            heaps: Start states.
            objects: The set that the heaps' names refer to.
            config: The task.
            keys: Observation keys.
            world_of: Makes the physics of some objects.
            effector: What is seen of the end effector, its origin at the tip.
            robot_in_view: Whether observations show it; otherwise it moves aside to look.

        Raises:
            MechSearchError: If there is no heap, one names an unknown object, or a key is unknown.
        """
        self.heaps = tuple(heaps)
        self._objects, self._config = objects, config
        self._world_of, self._effector = world_of, effector
        self._robot_in_view = robot_in_view
        if not self.heaps:
            raise MechSearchError("an environment needs at least one heap; got none")
        missing = sorted({n for h in heaps for n in h.objects if n not in objects.models})
        if missing:
            raise MechSearchError(
                f"object set {objects.name!r} lacks {', '.join(missing[:5])}; the heaps were made "
                "with another set"
            )
        largest = max(len(heap.objects) for heap in heaps) - 1
        if config.max_clutter != 0 and config.max_clutter < largest:
            raise MechSearchError(
                f"max_clutter is {config.max_clutter}, but a heap has {largest} non-target "
                f"objects; expected at least {largest}, or 0 to fit"
            )
        self._labels = {name: i for i, name in enumerate(objects.models)}
        self.observer = Observer(
            keys,
            preset(config.camera, config.image_size),
            config.max_clutter or largest,
            len(self._labels),
        )
        # Occlusion is measured from the standard view, whatever the policy's image size.
        self.camera = preset(config.camera)
        self._finder, self.judge = config.finder, config.judge
        self._kept: OrderedDict[int, tuple[W, Renderer]] = OrderedDict()
        self._index, self._episode = -1, 0

    @property
    def heap(self) -> Heap:
        """The heap on the table.

        Raises:
            MechSearchError: If there is none yet.
        """
        if self._index < 0:
            raise MechSearchError("no episode has begun; call reset first")
        return self.heaps[self._index]

    @property
    def state(self) -> HeapState:
        """The true state."""
        _ = self.heap
        return HeapState(self.poses.copy(), self.world.pusher_position, self.occlusion)

    @property
    def clutter(self) -> Floats:
        """How far the last action has moved each non-target object (N - 1,) [m]."""
        return self.moved[others(self.heap.target, len(self.moved))]

    @property
    def target_moved(self) -> float:
        """How far the last action has moved the target [m]."""
        return float(self.moved[self.heap.target])

    @property
    def target_is_present(self) -> bool:
        """Whether the target is still on the table."""
        return bool(self.present[self.heap.target])

    def reset(self, rng: np.random.Generator, options: Mapping[str, Any] | None) -> int:
        """Put a heap on the table as it was made and came to rest; return its index.

        Args:
            rng: Draws the heap, and where the end effector starts.
            options: Of `HeapEnv.reset`.

        Raises:
            MechSearchError: If an option is no good, or there is no room for a start.
            RuntimeError: If the heap does not come to rest in the task's engine.
        """
        meant = start_options(options, len(self.heaps))
        index = int(rng.integers(len(self.heaps)) if meant["heap"] is None else meant["heap"])
        self._index, (self.world, self.renderer) = index, self._opened(index)
        heap = self.heap
        if meant["fixed_start"]:
            rng = np.random.default_rng([heap.seed, 1])
        poses = self.world.settled(heap.poses)
        self.world.reset(poses, self._sample_start(rng, poses))
        perfect = self._config.sees.is_perfect
        self._begin(0 if perfect or meant["fixed_start"] else int(rng.integers(2**31)))
        self.poses = self.world.poses
        self.present = np.ones(len(heap.objects), np.bool_)
        self.moved = np.zeros(len(heap.objects))
        self.occlusion = self._measure_occlusion()
        return index

    def push(self, goal: Floats) -> str | None:
        """Push towards a point (3,) [m]; return the name of a simulator failure, or None."""
        if self.world.push(goal):
            return self.look()
        self.stay()
        return None

    def look(self, stowed: Sequence[int] = ()) -> str | None:
        """Take what an action came to; return the name of a simulator failure, or None.

        After a failure the last trusted state is put back.

        Args:
            stowed: Objects that the world has just put into a tray; they have not moved.
        """
        failure = self.world.failure()
        if failure is not None:
            self.go_back()
            return failure
        before, present = self.poses, self.present
        self._update_poses(stowed)
        way = self.poses[:, :3] - before[:, :3]
        self.moved = np.sqrt((way * way).sum(axis=1)) * present
        self.moved[list(stowed)] = 0.0
        if self.heap.target in stowed:
            self.occlusion = 0.0
        elif (self.poses != before).any():
            self.occlusion = self._measure_occlusion()
        return None

    def go_back(self) -> None:
        """Return to the state before an action whose physics failed."""
        self.world.reset(self.poses)
        self.stay()

    def stay(self) -> None:
        """Note that nothing has moved in the last action."""
        self.moved = np.zeros(len(self.poses))

    def picture(self, size: int) -> Array | None:
        """Return in colours what is in the task's view, on an image of `size` [px]."""
        camera = preset(self._config.camera, size)
        return self.renderer.frame(camera, self.poses, self._effector_pose(), True).rgb

    def measure(
        self,
        camera: Camera,
        step: int,
        poses: Floats,
        effector: Floats | None,
        labels: Callable[[Frame], Array],
        colour: bool = False,
    ) -> tuple[Array, Array, Array | None]:
        """Return depth, 0 in holes, masks and colours of the task's sensor, where it is.

        Args:
            camera: Where the sensor is believed to be, unless it is mounted elsewhere.
            step: Number of the episode's actions so far.
            poses: Of all objects (N, 7).
            effector: Pose of the end effector (7,); None leaves it out of view.
            labels: Returns the true masks in a frame; see `Sensor.segment`.
            colour: Whether colours are asked for.
        """
        sensing = self._sensing
        seen = sensing.camera(self._config.mount or camera)
        frame = self.renderer.frame(seen, poses, effector, colour or sensing.reads_colour)
        depth, masks = frame.depth, labels(frame)
        if not sensing.is_perfect:
            depth, masks = sensing.take(step, seen, depth, masks, frame.ids, frame.rgb)
        return depth, masks, frame.rgb

    def sense(
        self,
        camera: Camera,
        step: int,
        poses: Floats,
        effector: Floats | None,
        labels: Callable[[Frame], Array],
        colour: bool = False,
        level: bool = False,
        find: bool = False,
        bins: int = 1,
    ) -> tuple[Array, Array, Array | None]:
        """Return what is measured as it is seen in a view: reprojected, if the sensor is mounted.

        Args:
            camera: The view; this and what follows as in `measure`, where colours that are not
                asked for are reprojected all the same.
            step: Number of actions.
            poses: Of objects.
            effector: Pose of the end effector.
            labels: Returns true masks.
            colour: Whether colours are asked for.
            level: Whether an image with errors is held against the table, as `reproject` does.
            find: Whether the mask is the one that the task's segmenter finds, if it has one.
            bins: By how much the sensor's image is finer than the view; see `binned`.
        """
        mount, finer = self._config.mount, camera.resized(bins * camera.height)
        find = find and self._finder is not None
        depth, masks, rgb = self.measure(finer, step, poses, effector, labels, colour or find)
        if find:
            masks = self._found(step, finer, depth, rgb)
        if mount is not None:
            view = reproject(depth, mount, camera, masks, rgb, bins > 1)
            return view.depth, np.asarray(view.mask), view.colour
        depth, camera, masks, rgb = binned(depth, finer, bins, masks, rgb)
        if level and not self._sensing.is_perfect:
            depth, masks = _levelled(depth, masks, camera)
        return depth, masks, rgb

    def observe(self, step: int, keys: Iterable[str] | None = None) -> dict[str, Array]:
        """Return a fresh observation, or some keys of it, after so many actions of the episode."""
        heap, depth, mask, rgb = self.heap, None, None, None
        if IMAGE_KEYS & set(self.observer.keys if keys is None else keys):
            camera = preset(self._config.camera, self._config.image_size)
            bins = 1 if self._sensing.is_perfect else max(round(_FINE / camera.height), 1)
            depth, mask, rgb = self.sense(
                camera, step, self.poses, self._effector_in_view(),
                lambda frame: frame.modal(heap.target), self.observer.needs_colour,
                level=True, find=True, bins=bins,
            )  # fmt: skip
        return self.observer.observe(
            Scene(
                depth=depth,
                target_mask=mask,
                rgb=rgb,
                effector=self.world.pusher_position,
                ee_position=self._sensing.effector(self.world.pusher_position),
                positions=self.poses[:, :3],
                present=self.present,
                target=heap.target,
                label=self._labels[heap.objects[heap.target]],
            ),
            keys,
        )

    def observe_on_demand(self, step: int) -> Observation:
        """Return the same, but images are made when they are read, before the next action."""
        images = [key for key in self.observer.keys if key in IMAGE_KEYS]
        rest = [key for key in self.observer.keys if key not in IMAGE_KEYS]
        # Every action, snapshot and start says anew what has moved.
        now = self.moved

        def make() -> Observation:
            if self.moved is not now:
                raise MechSearchError("images made on demand are read before the next action")
            return self.observe(step, images)

        return OnDemand(self.observe(step, rest), images, make)

    def chance_uncovered(self, step: int) -> float:
        """Return with what chance an image shows the target uncovered, after so many actions."""
        judge, target = self.judge, self.heap.target
        assert judge is not None
        depth, mask, _ = self.sense(
            judge.camera, step, self.poses, self._effector_in_view(),
            lambda frame: frame.modal(target), find=True,
        )  # fmt: skip
        model = self._objects.models[self.heap.objects[target]]
        return judge.estimate(model, depth, mask).uncovered

    def _found(self, step: int, camera: Camera, depth: Array, rgb: Array | None) -> Array:
        """Return where the segmenter sees the target on the sensor's image.

        Unless that is of a mounted camera, it looks at one of its own size, and what it finds is
        brought to the size of the other.

        Args:
            step: Number of actions.
            camera: Of the sensor's image.
            depth: That image.
            rgb: Its colours.
        """
        heap, finder, mount = self.heap, self._finder, self._config.mount
        assert finder is not None
        target = self._objects.models[heap.objects[heap.target]]
        if mount is not None:
            return finder.visible(target, rgb, depth, mount)
        if camera != finder.camera:
            depth, _, rgb = self.measure(
                finder.camera, step, self.poses, self._effector_in_view(),
                lambda frame: np.zeros(frame.depth.shape, np.bool_), True,
            )  # fmt: skip
        return finder.visible(target, rgb, depth, finder.camera, camera.height)

    def _effector_in_view(self) -> Floats | None:
        return self._effector_pose() if self._robot_in_view else None

    def snapshot(self) -> dict[str, Array]:
        """Return all that comes of it depends on, as arrays."""
        _ = self.heap
        return {
            "heap": np.array(self._index),
            "world": self.world.snapshot(),
            "poses": self.poses.copy(),
            "present": self.present.copy(),
            "occlusion": np.array(self.occlusion),
        } | ({} if self._config.sees.is_perfect else {"episode": np.array(self._episode)})

    def restore(self, snapshot: Mapping[str, Array], counts: Sequence[str]) -> list[Any]:
        """Return to a snapshot, exactly.

        Args:
            snapshot: Of `snapshot`, and what an environment puts beside.
            counts: Names of the numbers that it puts beside.

        Returns:
            Those numbers.

        Raises:
            MechSearchError: If it does not fit; nothing has changed then.
        """
        expected = "expected what snapshot() returned in an environment of this kind and heaps"
        drawn = () if self._config.sees.is_perfect else ("episode",)
        names = (*_SAVED, *counts, *drawn)
        given = snapshot if isinstance(snapshot, Mapping) else {}
        missing = [name for name in names if name not in given]
        if missing:
            raise MechSearchError(f"a snapshot without {', '.join(missing)}; {expected}")
        saved = {
            name: real_array(given[name], f"a snapshot's {name}: {expected}") for name in names
        }
        index = int(saved["heap"]) if saved["heap"].shape == () else -1
        if not 0 <= index < len(self.heaps):
            raise MechSearchError(f"a snapshot of heap {shown(given['heap'])}; {expected}")
        world, renderer = self._opened(index)
        size = len(self.heaps[index].objects)
        shapes = {"world": world.snapshot().shape, "poses": (size, 7), "present": (size,)}
        for name, value in saved.items():
            if value.shape != shapes.get(name, ()):
                raise MechSearchError(
                    f"a snapshot whose {name} has shape {value.shape}; {expected}"
                )
        self._index, self.world, self.renderer = index, world, renderer
        world.restore(saved["world"])
        self.poses, self.present = np.array(saved["poses"]), np.array(saved["present"])
        self.occlusion = float(saved["occlusion"])
        self.moved = np.zeros(size)
        self._begin(int(saved["episode"]) if drawn else 0)
        return [saved[name].item() for name in counts]

    def _opened(self, index: int) -> tuple[W, Renderer]:
        """Return a heap's physics and renderer, which are kept for some heaps."""
        kept = self._kept
        if index in kept:
            kept.move_to_end(index)
        else:
            models = [self._objects.models[name] for name in self.heaps[index].objects]
            workspace = self._config.workspace
            renderer = Renderer(models, self._effector, workspace.table_half, workspace.floor)
            kept[index] = self._world_of(models), renderer
            if len(kept) > _WORLDS_KEPT:
                kept.popitem(last=False)
        return kept[index]

    def _begin(self, episode: int) -> None:
        """Take the number that the sensor's errors depend on, beside heap and step."""
        self._episode = episode
        seed = (self.heap.seed, 3, episode)
        self._sensing = self._config.sees.episode(seed, len(self.heap.objects))

    def _sample_start(self, rng: np.random.Generator, poses: Floats) -> Floats:
        """Return a contact-free position, uniform over the workspace, away from the target.

        Args:
            rng: Draws it.
            poses: Of the objects at rest (N, 7).
        """
        heap = self.heap
        centre = heap.poses[heap.target, :3]
        for _ in range(1000):
            position = self._config.workspace.sample(rng)
            if np.linalg.norm(position - centre) < self._config.start_distance:
                continue
            self.world.reset(poses, position)
            if self.world.pusher_is_free():
                return position
        raise MechSearchError(
            f"heap {heap.seed} leaves no room for a start at least "
            f"{self._config.start_distance} m from its target"
        )

    def _update_poses(self, stowed: Sequence[int]) -> None:
        """Take the objects' new poses; those that left the table stay where they left it.

        Those in the tray lie beside the table as they lay on it.
        """
        poses = self.world.poses
        if not self.present.all():
            poses[~self.present] = self.poses[~self.present]
        if stowed:
            taken = list(stowed)
            poses[taken] = self.poses[taken]
            poses[taken, 0] += 2 * self._config.workspace.table_half + _TRAY_AWAY
            self.present = np.where(np.isin(np.arange(len(poses)), taken), False, self.present)
        gone = self.present & self._config.workspace.off_table(poses)
        if gone.any():
            for index in np.flatnonzero(gone):
                self.world.remove(int(index))
            self.present = self.present & ~gone
        self.poses = poses

    def _measure_occlusion(self) -> float:
        if not self.present[self.heap.target]:
            return 1.0
        return self.renderer.occlusion(
            self.camera, self.poses, self.heap.target, self.present, self._effector_pose()
        )

    def _effector_pose(self) -> Floats:
        return self._config.pusher.pose(self.world.pusher_position)


class SceneEnv(gymnasium.Env[Any, Array], Generic[W]):
    """What environments of all kinds share: a scene, which users look at but do not copy."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 5}  # noqa: RUF012
    _scene: HeapScene[W]

    def __init__(self, config: HeapEnvConfig, kind: type[HeapEnvConfig], mode: str | None) -> None:
        """Take a task, which must be of a kind, and a render mode: "rgb_array" or None.

        Raises:
            MechSearchError: If they are anything else.
        """
        if not isinstance(config, kind):
            raise MechSearchError(f"config is {shown(config)}; expected a {kind.__name__}")
        if mode not in (None, "rgb_array"):
            raise MechSearchError(f"unknown render_mode {mode!r}; choose 'rgb_array' or None")
        self.render_mode = mode

    @property
    def heap(self) -> Heap:
        """The heap of the current episode.

        Raises:
            MechSearchError: If none has begun.
        """
        return self._scene.heap

    @property
    def world(self) -> W:
        """The physics of the current episode, for measurements; stepping it is cheating."""
        _ = self.heap
        return self._scene.world

    @property
    def state(self) -> HeapState:
        """The true state; what is in a tray is said to lie beside the table."""
        return self._scene.state

    def render(self) -> Array | None:
        """Return a colour picture (256, 256, 3) uint8, when made with render_mode="rgb_array"."""
        if self.render_mode != "rgb_array":
            return None
        _ = self.heap
        return self._scene.picture(256)

    def __reduce_ex__(self, protocol: object) -> NoReturn:
        raise MechSearchError(
            "an environment is neither copied nor pickled; make another with the same heaps, and "
            "hand what snapshot() returns to its restore"
        )


def start_options(options: Any, heaps: int, also: Sequence[str] = ()) -> dict[str, Any]:
    """Return what the options of `HeapEnv.reset` mean: `heap`, None for any, and `fixed_start`.

    Args:
        options: As users give them; None for none.
        heaps: How many there are.
        also: Names of further options, which are returned as they are.

    Raises:
        MechSearchError: If they mean nothing.
    """
    known = ("heap", "fixed_start", *also)
    if not isinstance(options, Mapping | None):
        raise MechSearchError(
            f"options are {shown(options)}; expected a mapping with any of {', '.join(known)}"
        )
    meant = {"heap": None, "fixed_start": False} | dict(options or {})
    for name in meant:
        if name not in known:
            raise MechSearchError(f"unknown option {name!r}; choose among {', '.join(known)}")
    heap, fixed = meant["heap"], meant["fixed_start"]
    if not isinstance(fixed, bool | np.bool_):
        raise MechSearchError(f"fixed_start is {shown(fixed)}; expected True or False")
    if heap is not None:
        if isinstance(heap, bool) or not isinstance(heap, Real) or heap % 1 != 0:
            raise MechSearchError(
                f"heap is {shown(heap)}; expected a whole number from 0 to {heaps - 1}"
            )
        meant["heap"] = index = int(cast("float", heap))
        if not 0 <= index < heaps:
            raise MechSearchError(f"heap {shown(heap)} does not exist; choose 0 to {heaps - 1}")
    return meant


def displacement(action: Any) -> Floats:
    """Return the commanded displacement (3,) [m] of an action, at most 5 cm long.

    Raises:
        MechSearchError: If the action is anything but three finite numbers.
    """
    numbers = finite_numbers(action, (3,), _ACTION).tolist()
    return cap_length([min(max(n, -1.0), 1.0) * ACTION_LENGTH for n in numbers], ACTION_LENGTH)


def choose_heaps(
    condition: str, heaps: str | Path | None, objects: str, split: str
) -> tuple[list[Heap], ObjectSet, str]:
    """Return the heaps of a split, their objects, and the camera that they were made for.

    Args:
        condition: "single" or "dual"; chooses among the embedded heaps.
        heaps: Heap set file; None takes the embedded heaps of household objects.
        objects: Object set that the heaps were made with.
        split: "held-out", "train" or "all" of the heaps.

    Raises:
        MechSearchError: If a name is unknown, or heaps and objects do not fit.
    """
    for name, text in (("condition", condition), ("objects", objects), ("split", split)):
        if not isinstance(text, str | None):
            raise MechSearchError(f"{name} is {shown(text)}; expected a text")
    if not isinstance(heaps, str | PathLike | None):
        raise MechSearchError(f"heaps are {shown(heaps)}; expected the file of a heap set")
    file = embedded_file(condition) if heaps is None else Path(heaps)
    heap_set, object_set = open_heaps(file, objects)
    return [heap_set.heaps[i] for i in heap_set.choose(split)], object_set, heap_set.camera


def _levelled(depth: Array, masks: Array, camera: Camera) -> tuple[Array, Array]:
    """Return an image held against its table; masks go on in holes, which stay holes."""
    marked = masks + _HOLE * (depth == 0)
    view = reproject(without_holes(depth, most=1.0), camera, camera, marked)
    seen = np.asarray(view.mask)
    return np.where(seen >= _HOLE, 0, view.depth), (seen % _HOLE).astype(masks.dtype)
