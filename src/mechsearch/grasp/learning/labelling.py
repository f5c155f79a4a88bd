"""Label grasps by trying them: the set that a network learns from.

No network proposes or judges a grasp. Every visible object of every heap is the target in turn;
its grasps are the policy's own angles and depths on its pixels, and a share of geometric ones, so
that success is not too rare to learn.
"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mechsearch.files import alone
from mechsearch.grasp.grasp_view import GraspView, view_of_heap
from mechsearch.grasp.image_grasp import FIELD, ImageGrasp, angle_bin
from mechsearch.grasp.learning.grasp_set import OUTCOMES, GraspFolder, Grasps
from mechsearch.grasp.learning.proposals import antipodal, uniform
from mechsearch.heaps.dataset import Heap, HeapSet, check_objects, object_set
from mechsearch.processes import Progress, map_in_order, silent
from mechsearch.sim.gripper import Gripper
from mechsearch.sim.lift import LiftWorld, Perturbation, perturbed
from mechsearch.sim.world import ENGINE_VERSION
from mechsearch.types import Array, MechSearchError

_LEAST_VISIBLE = 16
"""Pixels of an object from which grasps are proposed on it."""


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
        starts = range(0, len(heaps), config.shard)
        missing = [start for start in starts if not folder.has(_name(start, config))]
        done = len(heaps) - sum(len(heaps[start : start + config.shard]) for start in missing)
        progress("labelled heaps", done, len(heaps))
        tasks = (heap for start in missing for heap in heaps[start : start + config.shard])
        labelled = map_in_order(partial(label_heap, objects=objects, config=config), tasks, workers)
        for start in missing:
            parts = []
            for _ in heaps[start : start + config.shard]:
                parts.append(next(labelled))
                done += 1
                progress("labelled heaps", done, len(heaps))
            folder.add(_name(start, config), Grasps.concatenated(parts))
        return folder


def label_heap(heap: Heap, objects: str, config: LabelConfig) -> Grasps:
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
            outcome = world.lift(heap.poses, index, pose, friction)
            seen = thumbnail(view, grasp)
            number = OUTCOMES.index(outcome)
            rows.append((seen, grasp.depth, int(angle_bin(grasp.angle)), number, geometric, index))
    return _collected(rows, heap)


def _collected(rows: list[tuple[Array, float, int, int, bool, int]], heap: Heap) -> Grasps:
    seen, depth, angle, outcome, geometric, index = list(zip(*rows, strict=True)) or [()] * 6
    return Grasps(
        np.array(seen, np.float16).reshape(-1, FIELD, FIELD),
        np.array(depth, np.float32),
        np.array(angle, np.uint8),
        np.array(outcome, np.uint8),
        np.array(geometric, np.bool_),
        np.full(len(rows), heap.seed, np.int64),
        np.array([heap.objects[i] for i in index], np.str_),
    )


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


def _name(start: int, config: LabelConfig) -> str:
    return f"grasps-{start // config.shard:05d}.npz"
