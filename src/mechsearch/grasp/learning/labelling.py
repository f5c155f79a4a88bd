"""Label grasps by trying them, and keep them: the set that a network learns from.

No network proposes or judges a grasp. Every visible object of every heap is the target in turn;
its grasps are the policy's own angles and depths on its pixels, and a share of geometric ones, so
that success is not too rare to learn.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mechsearch.files import alone
from mechsearch.grasp.grasp_view import FIELD, GraspView, ImageGrasp, angle_bin, view_of_heap
from mechsearch.grasp.learning.grasp_folder import (
    OUTCOMES,
    GraspFolder,
    LabelledGrasps,
    load_labelled,
)
from mechsearch.grasp.proposals import antipodal, uniform
from mechsearch.heaps.dataset import Heap, HeapSet, check_objects, object_set
from mechsearch.processes import Progress, silent
from mechsearch.sim.gripper import Gripper
from mechsearch.sim.lift import LiftWorld, Outcome, Perturbation, perturbed
from mechsearch.sim.world import ENGINE_VERSION
from mechsearch.types import MechSearchError

_LEAST_VISIBLE = 16
"""Pixels of an object from which grasps are proposed on it."""

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
        if view.mask.sum() < _LEAST_VISIBLE:
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
