"""Heaps, and sets of them: one Parquet file each, with a manifest, half of it held out."""

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from mechsearch.files import write_whole
from mechsearch.objects.catalog import load_object_set
from mechsearch.objects.model import ObjectSet
from mechsearch.types import Floats, MechSearchError

HEAPS_FORMAT = 1

CONDITIONS = {"single": (5, 10, 15), "dual": (5, 6, 7, 8, 9, 10)}
"""Objects in each heap (paper, section IV-A): one heap near the centre, or two heaps apart."""

EMBEDDED = {
    f"household-{condition}": Path(__file__).with_name(f"household_{condition}.parquet")
    for condition in CONDITIONS
}
"""Small heap sets of household objects that the package holds."""

SPLITS = ("held-out", "train", "all")
"""Halves of a heap set, and both of them."""

_SCHEMA = pa.schema({
    "objects": pa.list_(pa.string()), "poses": pa.list_(pa.float64()), "target": pa.int32(),
    "occlusion": pa.float64(), "seed": pa.int64(), "count": pa.int32(), "condition": pa.string(),
    "held_out": pa.bool_(),
})  # fmt: skip


@dataclass(frozen=True)
class Heap:
    """A settled start state.

    Attributes:
        objects: Names (N,), distinct.
        poses: Of all objects at rest (N, 7): centre of mass [m], quaternion (w, x, y, z).
        target: Index of the target among `objects`.
        occlusion: Of the target, from the heap set's camera, in [0, 1].
        seed: Identifies the heap; its evaluation start and all episode randomness derive from it.
        count: Objects in each heap, so N for `single` and N / 2 for `dual`.
        condition: "single" or "dual".
        held_out: Whether the heap is kept for evaluation.
    """

    objects: tuple[str, ...]
    poses: Floats
    target: int
    occlusion: float
    seed: int
    count: int
    condition: str
    held_out: bool


def check_condition(condition: str) -> str:
    """Return the condition.

    Raises:
        MechSearchError: If there is no such condition.
    """
    if condition not in CONDITIONS:
        raise MechSearchError(
            f"unknown condition {condition!r}; choose one of {', '.join(CONDITIONS)}"
        )
    return condition


def evenly_spread(count: int, chosen: int) -> list[int]:
    """Return `chosen` of the indices below `count`, evenly spread.

    Heaps are kept by object count, so an even spread has all counts alike.
    """
    return [i * count // chosen for i in range(chosen)]


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


def save_heaps(path: str | Path, heaps: Sequence[Heap], manifest: Mapping[str, Any]) -> HeapSet:
    """Write a heap set, whole or not at all."""
    heap_set = HeapSet(tuple(heaps), dict(manifest), _hash(heaps, manifest))
    metadata = {
        b"mechsearch": json.dumps(manifest, sort_keys=True).encode(),
        b"sha256": heap_set.hash.encode(),
    }
    table = pa.Table.from_pylist([heap_to_json(heap) for heap in heaps], _SCHEMA)
    write_whole(
        Path(path), lambda partial: pq.write_table(table.replace_schema_metadata(metadata), partial)
    )
    return heap_set


def join_heaps(sets: Sequence[HeapSet], path: Path) -> HeapSet:
    """Write one set of the heaps of several, such as single and dual ones, and return it.

    Its manifest has theirs as `parts`, and the settings that they share.

    Raises:
        MechSearchError: If there are fewer than two, they are not of the same objects, camera and
            engine, a heap is in two of them, or `path` is there already.
    """
    if len(sets) < 2 or path.exists():
        raise MechSearchError(
            f"{path} exists already; name another file or remove it"
            if path.exists()
            else f"{len(sets)} heap sets given; expected at least two"
        )
    first = sets[0]
    hashes: dict[str, str] = {}
    for one in sets:
        hashes |= one.manifest["object_hashes"]
        for name, own, other in (
            ("objects", first.objects, one.objects), ("camera", first.camera, one.camera),
            ("engine", first.manifest["engine"], one.manifest["engine"]),
        ):  # fmt: skip
            if own != other:
                raise MechSearchError(
                    f"one heap set has the {name} {own!r}, another {other!r}; expected the same"
                )
        if any(hashes[name] != digest for name, digest in first.manifest["object_hashes"].items()):
            raise MechSearchError("the heap sets are of different objects of the same names")
    heaps = [heap for one in sets for heap in one.heaps]
    if len({(heap.seed, heap.condition) for heap in heaps}) < len(heaps):
        raise MechSearchError("a heap is in two of the heap sets; expected each once")
    configs = [one.manifest["config"] for one in sets]
    shared = {k: v for k, v in configs[0].items() if all(c.get(k) == v for c in configs)}
    conditions = "+".join(dict.fromkeys(c for one in sets for c in one.condition.split("+")))
    drops = sum(round(len(one.heaps) / one.manifest["acceptance_rate"]) for one in sets)
    manifest = {
        "format": HEAPS_FORMAT,
        "config": {"seed": None, **shared, "condition": conditions, "heaps": len(heaps)},
        "engine": first.manifest["engine"],
        "object_hashes": hashes,
        "acceptance_rate": len(heaps) / max(drops, 1),
        "parts": [part for one in sets for part in one.manifest.get("parts", [one.manifest])],
    }
    return save_heaps(path, heaps, manifest)


def load_heaps(path: str | Path) -> HeapSet:
    """Read a heap set.

    Args:
        path: File, or one of `EMBEDDED` where there is no such file.

    Raises:
        MechSearchError: If the file is missing, damaged, or no heap set of a known format.
    """
    path = Path(path)
    # Of names too long for the system, Path's own questions raise.
    if not os.path.exists(path) and path.name.replace("_", "-") in EMBEDDED:
        path = EMBEDDED[path.name.replace("_", "-")]
    if not os.path.isfile(path):
        raise MechSearchError(
            f"no heap set at {path}; make one with `mechsearch heaps generate`, or name one that "
            f"the package holds: {', '.join(EMBEDDED)}"
        )
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


def embedded_file(condition: str) -> Path:
    """Return the file of the small heap set of household objects that the package holds."""
    return EMBEDDED[f"household-{check_condition(condition)}"]


def embedded_heaps(condition: str) -> HeapSet:
    """Return the small heap set of household objects that the package holds."""
    return load_heaps(embedded_file(condition))


def open_heaps(path: str | Path, objects: str = "") -> tuple[HeapSet, ObjectSet]:
    """Return a heap set and its objects, once it is certain that they belong together.

    Args:
        path: File of the heap set.
        objects: Object set; empty takes the one that the heaps were made with.

    Raises:
        MechSearchError: If one of the two is missing or damaged, or they do not fit.
    """
    heap_set = load_heaps(path)
    return heap_set, objects_of(heap_set, objects)


@cache
def object_set(spec: str) -> ObjectSet:
    """Return an object set, loaded once in each process."""
    return load_object_set(spec)


def objects_of(heap_set: HeapSet, given: str = "") -> ObjectSet:
    """Return the objects of a heap set; see `recorded_objects`."""
    return recorded_objects(_MADE, heap_set.objects, _used(heap_set), given)


def check_objects(heap_set: HeapSet, objects: ObjectSet) -> None:
    """Refuse a heap set that was made with other objects.

    Raises:
        MechSearchError: Naming the first objects that are missing or differ.
    """
    _check_hashes(_MADE, heap_set.objects, _used(heap_set), objects)


def recorded_objects(what: str, name: str, hashes: Mapping[str, str], given: str = "") -> ObjectSet:
    """Return the objects that a file was made with, once it is certain that they are.

    Args:
        what: Is about the objects, such as "this heap set was made".
        name: Of the object set, as the file has it.
        hashes: Of the objects that it uses, by name.
        given: Object set, as for `load_object_set`; empty takes the one of that name.

    Raises:
        MechSearchError: If it cannot be loaded, or is another.
    """
    try:
        found = object_set(given or name)
    except MechSearchError as error:
        raise error if given else MechSearchError(f"{_asking(what, name)}: {error}") from None
    _check_hashes(what, name, hashes, found)
    return found


_MADE = "this heap set was made"


def _used(heap_set: HeapSet) -> dict[str, str]:
    used = {name for heap in heap_set.heaps for name in heap.objects}
    return {name: heap_set.manifest["object_hashes"][name] for name in used}


def _asking(what: str, name: str) -> str:
    return f"{what} with {name!r} objects; name them, or the folder where they are, by --objects"


def _check_hashes(what: str, name: str, hashes: Mapping[str, str], found: ObjectSet) -> None:
    wrong = found.differing(hashes)
    if wrong:
        raise MechSearchError(
            f"{_asking(what, name)}: {len(wrong)} of the {len(hashes)} recorded objects are "
            f"missing from or differ in {found.name!r}: {', '.join(wrong[:5])}"
            f"{' ...' if len(wrong) > 5 else ''}"
        )
