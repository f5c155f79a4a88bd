"""Try grasps and keep what became of them: the sets that networks learn from.

Every visible object of every heap is the target in turn. For the paper's grasp network
(`label_grasps`) its grasps are the policy's own angles and depths on its pixels, and a share of
geometric ones, so that success is not too rare to learn; no network proposes or judges them.

For the quality network of any gripper (`label_trials`) heaps are seen in many states. In the first
round the grasps are random proposals; later a network picks a share of them, so that its own
confident failures are among what it learns from next.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from mechsearch.files import alone
from mechsearch.grasp.grasp_scene import grasp_renderer, see_heap, view_of_heap
from mechsearch.grasp.learning.grasp_folder import (
    OUTCOMES,
    GraspFolder,
    LabelledGrasps,
    load_labelled,
    read_manifest,
    sha256,
)
from mechsearch.grasp.learning.states import states_of
from mechsearch.grasp.proposals import antipodal, uniform
from mechsearch.grasp.quality_network import (
    QualityNetwork,
    load_quality_network,
)
from mechsearch.grippers import (
    FIELD,
    LEAST_VISIBLE,
    PROPOSALS,
    Aligned,
    GraspView,
    Gripper,
    HeightMap,
    ImageGrasp,
    RatedGrasps,
    aligned,
    angle_bin,
    grid_of,
    gripper_named,
    height_map,
    propose,
    rate_grasps,
    segment_view,
)
from mechsearch.heaps.dataset import Heap, HeapSet, check_objects, object_set
from mechsearch.processes import Progress, silent
from mechsearch.sim import (
    ENGINE_VERSION,
    GripperWorld,
    LiftWorld,
    Perturbation,
    perturbed,
)
from mechsearch.types import Floats, MechSearchError, Outcome

_TYPES = (np.float16, np.float32, np.uint8, np.uint8, np.bool_, np.int64, np.str_)
"""Of the arrays of `Grasps`."""


@dataclass(frozen=True, eq=False)
class Grasps(LabelledGrasps):
    """Labelled grasps (n,), and what the network sees of each.

    Attributes:
        relative: Depth minus gripper depth (n, 96, 96) float16 [m], the grasp centre at pixel 48.
        depth: Of the gripper (n,) float32 [m].
        bin: Of the closing direction (n,) uint8.
        outcome: Index in `OUTCOMES` (n,) uint8.
        geometric: Whether geometry proposed the grasp, not chance (n,) bool.
        heap: Seed of the heap (n,) int64.
        object: Name of the object to lift (n,), text.
    """

    relative: NDArray[np.float16]
    depth: NDArray[np.float32]
    bin: NDArray[np.uint8]
    outcome: NDArray[np.uint8]
    geometric: NDArray[np.bool_]
    heap: NDArray[np.int64]
    object: NDArray[np.str_]

    @property
    def success(self) -> NDArray[np.bool_]:
        """The labels (n,)."""
        return np.asarray(self.outcome == OUTCOMES.index(Outcome.SUCCESS), np.bool_)

    @property
    def counts(self) -> Counter[str]:
        """How many grasps came to which outcome."""
        return Counter(str(OUTCOMES[number]) for number in self.outcome)


def load_grasps(path: Path) -> Grasps:
    """Return all grasps of a folder; see `load_labelled`."""
    return load_labelled(path, Grasps)


@dataclass(frozen=True)
class LabelConfig:
    """What to label.

    Attributes:
        per_object: Grasps on each visible object.
        geometric: Share of them that geometry proposes, where it finds as many.
        perturbed: Whether each grasp is executed with errors of place, direction and friction; its
            label is then one draw of what the network shall estimate, the chance of success.
        opening: Of the gripper [m].
        split: "train" or "held-out" heaps.
        limit: Number of heaps, spread evenly; 0 takes all.
        shard: Heaps in a file.
        seed: Of all randomness.
    """

    per_object: int = 10
    geometric: float = 0.8
    perturbed: bool = True
    opening: float = 0.056
    split: str = "train"
    limit: int = 0
    shard: int = 8
    seed: int = 0

    def __post_init__(self) -> None:
        if self.split not in ("train", "held-out"):
            raise MechSearchError(f"unknown split {self.split!r}; choose one of train, held-out")
        if self.per_object < 1 or self.shard < 1:
            raise MechSearchError(
                f"{self.per_object} grasps on each object, {self.shard} heaps in a file; expected "
                "at least 1 of each"
            )
        if not 0.0 <= self.geometric <= 1.0:
            raise MechSearchError(f"a geometric share of {self.geometric}; expected 0 to 1")


def label_grasps(
    heap_set: HeapSet,
    objects: str,
    config: LabelConfig,
    path: Path,
    workers: int = 1,
    progress: Progress = silent,
) -> GraspFolder:
    """Fill a folder with labelled grasps; go on if it was cut off.

    Args:
        heap_set: The heaps.
        objects: Object set, as given to `load_object_set`.
        config: What to label.
        path: The folder.
        workers: Processes; the grasps do not depend on their number.
        progress: Told after each heap.

    Raises:
        MechSearchError: If the objects are others, the folder holds other grasps, or another
            process fills it.
    """
    with alone(path / "grasps", f"the grasp set {path}"):
        check_objects(heap_set, object_set(objects))
        heaps = [heap_set.heaps[i] for i in heap_set.choose(config.split, config.limit)]
        identity = {"config": asdict(config), "heap_set": heap_set.hash, "engine": ENGINE_VERSION}
        folder = GraspFolder(path, identity)
        label = partial(_labelled, objects=objects, config=config)
        folder.fill(heaps, config.shard, label, Grasps, workers, progress)
        return folder


def _labelled(heap: Heap, objects: str, config: LabelConfig) -> Grasps:
    """Return the labelled grasps of one heap, a pure function of its arguments."""
    known = object_set(objects).models
    models = [known[name] for name in heap.objects]
    gripper = Gripper(opening=config.opening)
    world = LiftWorld(models, gripper)
    rng = np.random.default_rng([config.seed, heap.seed])
    rows = []
    for index in range(len(models)):
        view = view_of_heap(models, heap.poses, index)
        if view.mask.sum() < LEAST_VISIBLE:
            continue
        for grasp, geometric in _proposed(view, rng, config, gripper):
            pose, friction = grasp.pose(view.camera), gripper.friction
            if config.perturbed:
                pose, friction = perturbed(pose, rng, Perturbation())
            outcome = OUTCOMES.index(world.lift(heap.poses, index, pose, friction))
            seen, angle = thumbnail(view, grasp), int(angle_bin(grasp.angle))
            rows.append(
                (seen, grasp.depth, angle, outcome, geometric, heap.seed, heap.objects[index])
            )
    columns: list[tuple[Any, ...]] = list(zip(*rows, strict=True)) or [()] * len(_TYPES)
    arrays: list[Any] = [np.array(c, kind) for c, kind in zip(columns, _TYPES, strict=True)]
    return Grasps(arrays[0].reshape(-1, FIELD, FIELD), *arrays[1:])


def thumbnail(view: GraspView, grasp: ImageGrasp) -> NDArray[np.float16]:
    """Return what a network sees of a grasp (96, 96) float16: depth minus gripper depth [m]."""
    row, column = round(grasp.row), round(grasp.column)
    relative = view.around(row, row, column, column) - np.float32(grasp.depth)
    return relative.astype(np.float16)


def _proposed(
    view: GraspView, rng: np.random.Generator, config: LabelConfig, gripper: Gripper
) -> Iterator[tuple[ImageGrasp, bool]]:
    wanted = round(config.geometric * config.per_object)
    found = antipodal(view, rng, wanted, gripper) if wanted else []
    yield from ((grasp, True) for grasp in found)
    yield from ((grasp, False) for grasp in uniform(view, rng, config.per_object - len(found)))


_SUCCESS, _FAILURE = OUTCOMES.index(Outcome.SUCCESS), OUTCOMES.index(Outcome.FAILURE)


@dataclass(frozen=True, eq=False)
class Trials(LabelledGrasps):
    """Grasps (n,) that were each tried twice, and what a network sees of them.

    Attributes:
        relative: As in `Aligned` (n, R, C) float16 [m].
        target: Likewise (n, R, C).
        numbers: Likewise (n, 6).
        pose: Of the gripper's frame (n, 7).
        planned: What it came to, executed exactly: index in `OUTCOMES` (n,) uint8.
        noisy: Likewise, executed with errors of place, direction and friction.
        quality: As a network rated it (n,) float32; not a number for a random proposal.
        state: Kind of the state, index in `states.STATE_KINDS` (n,) uint8.
        heap: Seed of the heap (n,) int64.
        object: Name of the object to lift (n,), text.
    """

    relative: NDArray[np.float16]
    target: NDArray[np.bool_]
    numbers: NDArray[np.float32]
    pose: Floats
    planned: NDArray[np.uint8]
    noisy: NDArray[np.uint8]
    quality: NDArray[np.float32]
    state: NDArray[np.uint8]
    heap: NDArray[np.int64]
    object: NDArray[np.str_]

    @property
    def won(self) -> NDArray[np.bool_]:
        """Whether each execution succeeded (n, 2)."""
        return np.asarray(np.stack([self.planned, self.noisy], axis=1) == _SUCCESS)

    @property
    def success(self) -> Floats:
        """The labels (n,): shares of the executions that succeed."""
        return np.asarray(self.won.mean(axis=1))

    @property
    def sound(self) -> NDArray[np.bool_]:
        """Which grasps (n,) no failure of the physics makes worthless."""
        return np.asarray((self.planned != _FAILURE) & (self.noisy != _FAILURE))

    @property
    def seen(self) -> Aligned:
        """What a network sees of them."""
        return Aligned(self.relative.astype(np.float32), self.target, self.numbers)

    @property
    def counts(self) -> Counter[str]:
        """How many executions came to which outcome."""
        return Counter(str(OUTCOMES[n]) for n in np.concatenate([self.planned, self.noisy]))


@dataclass(frozen=True)
class TrialConfig:
    """What to try.

    Attributes:
        gripper: By name.
        per_object: Grasps on each visible object of each state.
        best: Share of them that are the best-rated, where a network is given.
        proposals: Among which those are.
        removed: States of each heap with some objects removed.
        pushed: States of each heap after pushes.
        alone: Whether to try each object alone too.
        split: "train" or "held-out" heaps.
        limit: Number of heaps, spread evenly; 0 takes all.
        shard: Heaps in a file.
        seed: Of all randomness.
    """

    gripper: str = "jaws-85"
    per_object: int = 8
    best: float = 0.5
    proposals: int = PROPOSALS
    removed: int = 1
    pushed: int = 1
    alone: bool = True
    split: str = "train"
    limit: int = 0
    shard: int = 8
    seed: int = 0

    def __post_init__(self) -> None:
        gripper_named(self.gripper)
        if self.split not in ("train", "held-out"):
            raise MechSearchError(f"unknown split {self.split!r}; choose one of train, held-out")
        if self.per_object < 1 or self.shard < 1 or self.proposals < self.per_object:
            raise MechSearchError(
                f"{self.per_object} of {self.proposals} proposals on each object, {self.shard} "
                "heaps in a file; expected at least 1, no more than there are, and 1"
            )
        if not 0.0 <= self.best <= 1.0:
            raise MechSearchError(f"a best-rated share of {self.best}; expected 0 to 1")


def label_trials(
    heap_set: HeapSet,
    objects: str,
    config: TrialConfig,
    path: Path,
    network: Path | None = None,
    workers: int = 1,
    progress: Progress = silent,
) -> GraspFolder:
    """Fill a folder with grasps that were tried; go on if it was cut off.

    Args:
        heap_set: The heaps.
        objects: Object set, as given to `load_object_set`.
        config: What to try.
        path: The folder.
        network: File of the network that picks a share of the grasps; None leaves all to chance.
        workers: Processes; the grasps do not depend on their number.
        progress: Told after each heap.

    Raises:
        MechSearchError: If the objects are others, the network is of another gripper, the folder
            holds other grasps, or another process fills it.
    """
    if network is not None:
        load_quality_network(config.gripper, network)
    with alone(path / "grasps", f"the grasp set {path}"):
        check_objects(heap_set, object_set(objects))
        heaps = [heap_set.heaps[i] for i in heap_set.choose(config.split, config.limit)]
        identity = {
            "trials": asdict(config), "heap_set": heap_set.hash, "engine": ENGINE_VERSION,
            "network": sha256(network) if network else None,
        }  # fmt: skip
        folder = GraspFolder(path, identity)
        label = partial(trials_of_heap, objects=objects, config=config, network=network)
        folder.fill(heaps, config.shard, label, Trials, workers, progress)
        return folder


def load_trials(path: Path) -> Trials:
    """Return all grasps of a folder; see `load_labelled`."""
    return load_labelled(path, Trials)


def load_rounds(gripper: str, paths: Sequence[Path]) -> Trials:
    """Return all grasps of several folders.

    Args:
        gripper: That they were tried with, by name.
        paths: The folders, at least one.

    Raises:
        MechSearchError: If there is no such gripper, a folder is of another one or none is named,
            or as `load_labelled`.
    """
    gripper_named(gripper)
    if not paths:
        raise MechSearchError("no folder of tried grasps named; expected at least one")
    rounds = [load_trials(path) for path in paths]
    for path in paths:
        found = read_manifest(path)["trials"]["gripper"]
        if found != gripper:
            raise MechSearchError(f"{path} holds grasps of {found!r}; expected {gripper!r}")
    return Trials.concatenated(rounds)


def trials_of_heap(
    heap: Heap, objects: str, config: TrialConfig, network: Path | None = None
) -> Trials:
    """Return the grasps tried in one heap, a pure function of its arguments."""
    known = object_set(objects).models
    models = [known[name] for name in heap.objects]
    rater = _rater(config.gripper, network) if network else None
    gripper, renderer = gripper_named(config.gripper), grasp_renderer(models)
    grid = grid_of(gripper)
    parts = [_nothing(grid.rows, grid.columns)]
    # The states are the same whoever picks the grasps.
    rng = np.random.default_rng([config.seed, heap.seed])
    alone = range(len(models)) if config.alone else ()
    states = states_of(models, heap.poses, rng, config.removed, config.pushed, alone)
    for number, state in enumerate(states):
        world = GripperWorld([models[i] for i in state.present], [gripper])
        poses = state.poses[state.present]
        scene = see_heap(renderer, state.poses, int(state.present[0]))
        for segment, index in enumerate(scene.objects, start=1):
            view = segment_view(scene.depth, scene.segments, segment)
            if view.mask.sum() < LEAST_VISIBLE:
                continue
            own = np.random.default_rng([config.seed, heap.seed, number, index])
            heights = height_map(view)
            found = propose(heights, own, config.proposals, gripper)
            if not len(found):
                continue
            chosen = _chosen(heights, found, config, rater)
            place = int(np.flatnonzero(state.present == index)[0])
            outcomes = []
            for pose in chosen.poses:
                draw = perturbed(pose, own, Perturbation())
                planned = world.try_grasp(poses, place, pose)
                noisy = world.try_grasp(poses, place, draw[0], friction=draw[1])
                outcomes.append([OUTCOMES.index(planned), OUTCOMES.index(noisy)])
            came_to = np.array(outcomes, np.uint8).reshape(-1, 2)
            seen, count = aligned(heights, chosen.poses, grid), len(chosen)
            parts.append(Trials(
                seen.relative.astype(np.float16), seen.target, seen.numbers, chosen.poses,
                came_to[:, 0], came_to[:, 1], chosen.quality.astype(np.float32),
                np.full(count, state.kind, np.uint8), np.full(count, heap.seed, np.int64),
                np.full(count, heap.objects[index]),
            ))  # fmt: skip
    return Trials.concatenated(parts)


def _chosen(
    heights: HeightMap, found: Floats, config: TrialConfig, rater: QualityNetwork | None
) -> RatedGrasps:
    """Return the grasps to try: the best-rated ones apart, if a network is given, and by chance."""
    best = RatedGrasps(found[:0], np.empty(0))
    if rater is not None:
        best = rate_grasps(rater, heights, found).apart(round(config.best * config.per_object))
    drawn = found[: config.per_object - len(best)]
    unrated = np.full(len(drawn), np.nan)
    return RatedGrasps(np.concatenate([best.poses, drawn]), np.concatenate([best.quality, unrated]))


def _nothing(rows: int, columns: int) -> Trials:
    """Return no grasps."""
    none = np.empty(0, np.uint8)
    return Trials(
        np.empty((0, rows, columns), np.float16), np.empty((0, rows, columns), np.bool_),
        np.empty((0, 6), np.float32), np.empty((0, 7)), none, none, np.empty(0, np.float32), none,
        np.empty(0, np.int64), np.empty(0, np.str_),
    )  # fmt: skip


@lru_cache(maxsize=1)
def _rater(gripper: str, network: Path) -> QualityNetwork:
    """Return a network, loaded once in each process, which has one processor."""
    torch.set_num_threads(1)
    return load_quality_network(gripper, network)
