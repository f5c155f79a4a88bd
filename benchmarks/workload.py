"""What every stack is given: heaps, and pushes recorded on them that both then repeat."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig
from mechsearch.evaluation.rollout import run_episode
from mechsearch.geometry import cap_length
from mechsearch.heaps.dataset import Heap, HeapSet, embedded_heaps, load_heaps, save_heaps
from mechsearch.objects.catalog import load_object_set
from mechsearch.objects.model import ObjectModel, ObjectSet
from mechsearch.teachers import PAPER_TEACHERS, make_teacher
from mechsearch.types import ACTION_LENGTH, Array, Floats

ROOT = Path(__file__).resolve().parents[1]
HEAPS = ROOT / "results" / "heaps" / "ycb_single.parquet"
LONGEST = 30
"""Actions of an episode that are recorded, at most."""


@dataclass(frozen=True, eq=False)
class Episode:
    """A teacher's push, to be repeated.

    Attributes:
        heap: The start state.
        models: Its objects, in the order of its poses.
        actions: Commands (T, 3) in [-1, 1].
        ee_positions: End effector (T + 1, 3) [m], the start first.
        poses: Of all objects (T + 1, N, 7).
    """

    heap: Heap
    models: Sequence[ObjectModel]
    actions: Array
    ee_positions: Floats
    poses: Floats

    @property
    def offsets(self) -> Floats:
        """The commanded displacements (T, 3) [m]."""
        wanted = np.clip(np.asarray(self.actions, np.float64), -1, 1) * ACTION_LENGTH
        return np.array([cap_length(offset, ACTION_LENGTH) for offset in wanted])

    @property
    def moving(self) -> list[int]:
        """The actions that moved an object."""
        same = (self.poses[1:] == self.poses[:-1]).reshape(len(self.actions), -1).all(axis=1)
        return [int(i) for i in np.flatnonzero(~same)]


@dataclass(frozen=True)
class Workload:
    """Heaps and their objects.

    Attributes:
        path: File of the heap set; None takes the embedded one.
        objects: Object set, as given to `load_object_set`.
    """

    path: Path | None
    objects: str

    @cached_property
    def heap_set(self) -> HeapSet:
        """The heaps whose objects are the same here as where they were made."""
        heap_set = load_heaps(self.path) if self.path else embedded_heaps("single")
        recorded, present = heap_set.manifest["object_hashes"], self.object_set.hashes
        same = {name for name, digest in recorded.items() if present.get(name) == digest}
        heaps = tuple(heap for heap in heap_set.heaps if same.issuperset(heap.objects))
        if not heaps:
            raise SystemExit(f"no heap of {self.path} has the objects of {self.objects}")
        return replace(heap_set, heaps=heaps)

    @cached_property
    def object_set(self) -> ObjectSet:
        """The objects."""
        return load_object_set(self.objects)

    @property
    def title(self) -> str:
        """Which heaps these are."""
        return "household heaps" if self.objects == "household" else "YCB heaps"

    def heaps(self, count: int, number: int) -> list[Heap]:
        """Return held-out heaps of `count` objects, spread evenly, or as many as there are."""
        fitting = [heap for heap in self.heap_set.held_out if heap.count == count]
        number = min(number, len(fitting))
        return [fitting[i * len(fitting) // number] for i in range(number)]

    def models(self, heap: Heap) -> list[ObjectModel]:
        """Return a heap's objects, in the order of its poses."""
        return [self.object_set.models[name] for name in heap.objects]

    def env(self, heaps: Sequence[Heap], size: int = 64) -> HeapEnv:
        """Return our environment as a policy is trained in it: images, and no privileged keys."""
        config = HeapEnvConfig(camera=self.heap_set.camera, image_size=size)
        return HeapEnv(heaps, self.object_set, config)

    def episodes(self, heaps: Sequence[Heap]) -> list[Episode]:
        """Record one push on each heap, the three teachers in turn."""
        config = HeapEnvConfig(
            keys=("ee_position",), privileged=True, camera=self.heap_set.camera, max_actions=LONGEST
        )
        env = HeapEnv(heaps, self.object_set, config)
        teachers = [make_teacher(name) for name in PAPER_TEACHERS]
        records = [run_episode(teachers[i % 3], env, i) for i in range(len(heaps))]
        return [
            Episode(heap, self.models(heap), record.actions, record.ee_positions, record.poses)
            for heap, record in zip(heaps, records, strict=True)
        ]

    def written(self, heaps: Sequence[Heap], path: Path) -> "Workload":
        """Return a workload of other heaps of the same objects, written to a file."""
        hashes = self.object_set.hashes
        save_heaps(path, heaps, {**self.heap_set.manifest, "object_hashes": hashes})
        return Workload(path, self.objects)


def find_workload() -> Workload:
    """Return the YCB heaps of the results, or the embedded heaps where the objects are not."""
    folder = Path(os.environ.get("MECHSEARCH_YCB", ROOT.parent / "shared" / "ycb"))
    if HEAPS.is_file() and folder.is_dir():
        return Workload(HEAPS, str(folder))
    print("no YCB objects (name their folder in MECHSEARCH_YCB): household objects instead")
    return Workload(None, "household")
