"""Heap sets: one Parquet file each, with a manifest, half of it held out."""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from mechsearch.camera import preset
from mechsearch.files import write_whole
from mechsearch.heaps.heap import Heap, evenly_spread
from mechsearch.objects.catalog import load_object_set
from mechsearch.objects.model import ObjectSet
from mechsearch.processes import Failure, Progress, map_in_order, silent
from mechsearch.render.body import body_of
from mechsearch.render.visibility import occlusion
from mechsearch.sim.world import REST_LIMIT, drift
from mechsearch.types import MechSearchError

HEAPS_FORMAT = 1

SPLITS = ("held-out", "train", "all")
"""Halves of a heap set, and both of them."""

CHECK_LIMIT = 300.0
"""Time after which the check of a heap hangs [s]."""

_SCHEMA = pa.schema(
    [
        ("objects", pa.list_(pa.string())),
        ("poses", pa.list_(pa.float64())),
        ("target", pa.int32()),
        ("occlusion", pa.float64()),
        ("seed", pa.int64()),
        ("count", pa.int32()),
        ("condition", pa.string()),
        ("held_out", pa.bool_()),
    ]
)


@dataclass(frozen=True)
class CountSummary:
    """The heaps of one object count.

    Attributes:
        count: Objects in each heap.
        train: How many are for training.
        held_out: How many are kept for evaluation.
        occlusion: Of their targets: mean, least and greatest.
    """

    count: int
    train: int
    held_out: int
    occlusion: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class HeapSet:
    """Heaps and where they come from.

    Attributes:
        heaps: All heaps, in a fixed order.
        manifest: Configuration, engine version, object hashes, attempts and acceptance rate.
        hash: SHA-256 of heaps and manifest.
    """

    heaps: tuple[Heap, ...]
    manifest: Mapping[str, Any]
    hash: str

    @property
    def train(self) -> list[Heap]:
        """The half that policies may learn from."""
        return [heap for heap in self.heaps if not heap.held_out]

    @property
    def held_out(self) -> list[Heap]:
        """The half that is kept for evaluation."""
        return [heap for heap in self.heaps if heap.held_out]

    @property
    def camera(self) -> str:
        """Name of the view that occlusion is measured from."""
        return str(self.manifest["config"]["camera"])

    @property
    def objects(self) -> str:
        """Object set that the heaps were made with, as given to `load_object_set`."""
        return str(self.manifest["config"]["objects"])

    @property
    def condition(self) -> str:
        """Such as "single"."""
        return str(self.manifest["config"]["condition"])

    def choose(self, split: str = "held-out", limit: int = 0) -> tuple[int, ...]:
        """Return the indices of a split's heaps.

        Args:
            split: One of `SPLITS`.
            limit: How many, evenly spread over the split and so over the object counts; 0 takes
                all.

        Raises:
            MechSearchError: If there is no such split, or it has fewer heaps.
        """
        if split not in SPLITS:
            raise MechSearchError(f"unknown split {split!r}; choose one of {', '.join(SPLITS)}")
        wanted = {"held-out": (True,), "train": (False,), "all": (True, False)}[split]
        found = [i for i, heap in enumerate(self.heaps) if heap.held_out in wanted]
        if not found or not 0 <= limit <= len(found):
            raise MechSearchError(
                f"{limit or 'all'} heaps asked for; the heap set has {len(found)} {split} heaps"
            )
        return tuple(found[i] for i in evenly_spread(len(found), limit or len(found)))

    def summary(self) -> list[CountSummary]:
        """Return what the set holds, by object count."""
        found = []
        for count in sorted({heap.count for heap in self.heaps}):
            heaps = [heap for heap in self.heaps if heap.count == count]
            held_out, hidden = sum(h.held_out for h in heaps), [h.occlusion for h in heaps]
            shares = float(np.mean(hidden)), min(hidden), max(hidden)
            found.append(CountSummary(count, len(heaps) - held_out, held_out, shares))
        return found


def heap_to_json(heap: Heap) -> dict[str, Any]:
    """Return a heap as plain lists and numbers."""
    return {**vars(heap), "objects": list(heap.objects), "poses": heap.poses.ravel().tolist()}


def heap_from_json(row: Mapping[str, Any]) -> Heap:
    """Return the heap that `heap_to_json` wrote."""
    poses = np.array(row["poses"], np.float64).reshape(-1, 7)
    return Heap(**{**row, "objects": tuple(row["objects"]), "poses": poses})


def save_heaps(path: Path, heaps: Sequence[Heap], manifest: Mapping[str, Any]) -> HeapSet:
    """Write a heap set, whole or not at all."""
    heap_set = HeapSet(tuple(heaps), dict(manifest), _hash(heaps, manifest))
    metadata = {
        b"mechsearch": json.dumps(manifest, sort_keys=True).encode(),
        b"sha256": heap_set.hash.encode(),
    }
    table = pa.Table.from_pylist([heap_to_json(heap) for heap in heaps], _SCHEMA)
    write_whole(
        path, lambda partial: pq.write_table(table.replace_schema_metadata(metadata), partial)
    )
    return heap_set


def load_heaps(path: Path) -> HeapSet:
    """Read a heap set.

    Raises:
        MechSearchError: If the file is missing, damaged, or no heap set of a known format.
    """
    if not path.is_file():
        raise MechSearchError(f"no heap set at {path}; make one with `mechsearch heaps generate`")
    try:
        table = pq.read_table(path)
        metadata = table.schema.metadata or {}
        manifest = json.loads(metadata[b"mechsearch"])
        heaps = tuple(heap_from_json(row) for row in table.to_pylist())
        recorded = metadata[b"sha256"].decode()
    except (OSError, pa.ArrowException, KeyError, TypeError, ValueError) as error:
        raise MechSearchError(f"{path} is not a heap set, or is damaged: {error}") from None
    if not isinstance(manifest, dict):
        raise MechSearchError(f"{path} is not a heap set: its manifest is {manifest!r}")
    if manifest.get("format") != HEAPS_FORMAT:
        raise MechSearchError(
            f"{path} has heap set format {manifest.get('format')}; this version reads "
            f"{HEAPS_FORMAT}"
        )
    found = _hash(heaps, manifest)
    if found != recorded:
        raise MechSearchError(f"{path} is damaged: its content hashes to {found}, not {recorded}")
    return HeapSet(heaps, manifest, found)


def _hash(heaps: Sequence[Heap], manifest: Mapping[str, Any]) -> str:
    digest = hashlib.sha256(json.dumps(manifest, sort_keys=True).encode())
    for heap in heaps:
        row = heap_to_json(heap)
        digest.update(heap.poses.tobytes())
        digest.update(json.dumps({**row, "poses": None}, sort_keys=True).encode())
    return digest.hexdigest()


def open_heaps(path: Path, objects: str = "") -> tuple[HeapSet, ObjectSet]:
    """Return a heap set and its objects, once it is certain that they belong together.

    Args:
        path: File of the heap set.
        objects: Object set; empty takes the one that the heaps were made with.

    Raises:
        MechSearchError: If one of the two is missing or damaged, or they do not fit.
    """
    heap_set = load_heaps(path)
    found = object_set(objects or heap_set.objects)
    check_objects(heap_set, found)
    return heap_set, found


@cache
def object_set(spec: str) -> ObjectSet:
    """Return an object set, loaded once in each process."""
    return load_object_set(spec)


def check_objects(heap_set: HeapSet, objects: ObjectSet) -> None:
    """Refuse a heap set that was made with other objects.

    Raises:
        MechSearchError: Naming the first objects that are missing or differ.
    """
    used = {name for heap in heap_set.heaps for name in heap.objects}
    wrong = objects.differing({name: heap_set.manifest["object_hashes"][name] for name in used})
    if wrong:
        raise MechSearchError(
            f"this heap set was made with {heap_set.objects!r} objects, and "
            f"{len(wrong)} of the {len(used)} that it uses are missing from or differ in "
            f"{objects.name!r}: {', '.join(wrong[:5])}{' ...' if len(wrong) > 5 else ''}"
        )


@dataclass(frozen=True)
class Check:
    """What verifying one heap found.

    Attributes:
        seed: The heap.
        drift: How far its most restless object moves in one simulated second [m].
        occlusion_error: Recorded minus measured occlusion of the target.
    """

    seed: int
    drift: float
    occlusion_error: float

    @property
    def passed(self) -> bool:
        """Whether the heap is at rest and its target is occluded as recorded."""
        return self.drift <= REST_LIMIT and abs(self.occlusion_error) < 1e-9


def _checked(objects: str, camera: str, heap: Heap) -> Check:
    models = [object_set(objects).models[name] for name in heap.objects]
    bodies = [body_of(model) for model in models]
    measured = occlusion(bodies, preset(camera), heap.poses, heap.target)
    return Check(heap.seed, drift(models, heap.poses), heap.occlusion - measured)


def _unverified(heap: Heap, failure: Failure) -> Check:
    """Return the check of a heap that workers died of or hung in."""
    if failure.error is not None:
        raise failure.error
    return Check(heap.seed, float("inf"), float("nan"))


def verify(
    heap_set: HeapSet, objects: str = "", workers: int = 1, progress: Progress = silent
) -> Iterator[Check]:
    """Restore every heap, and measure its rest and its target's occlusion.

    Args:
        heap_set: What to verify.
        objects: Object set; empty takes the one that the heaps were made with.
        workers: Number of processes.
        progress: Told after each heap.

    Raises:
        MechSearchError: If the set was made with other objects.
    """
    named = objects or heap_set.objects
    check_objects(heap_set, object_set(named))
    check = partial(_checked, named, heap_set.camera)
    checks = map_in_order(check, heap_set.heaps, workers, CHECK_LIMIT, _unverified)
    for i, result in enumerate(checks):
        progress("verified", i + 1, len(heap_set.heaps))
        yield result
