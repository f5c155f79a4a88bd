"""Folders of labelled grasps, filled shard by shard and heap by heap, whatever is kept of each."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from itertools import chain, islice
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from mechsearch.files import read_arrays, read_record, write_record, write_whole
from mechsearch.heaps.dataset import Heap
from mechsearch.processes import Progress, map_in_order
from mechsearch.types import Array, MechSearchError, Outcome

_FORMAT = 1
_PURPOSE = "manifest of a grasp set"

MANIFEST_FILE = "grasps.json"
"""What a folder of labelled grasps holds, and from what they were made."""

OUTCOMES = tuple(Outcome)
"""What the outcome numbers of a grasp set mean."""


class LabelledGrasps:
    """Labelled grasps as arrays, one row each; a dataclass says which.

    Among them are `heap`, the seeds of the heaps (n,), and `success`, the labels (n,) in [0, 1].
    """

    heap: NDArray[np.int64]

    @property
    def success(self) -> Array:
        """The labels (n,)."""
        raise NotImplementedError

    def __len__(self) -> int:
        return len(self.heap)

    def where(self, keep: NDArray[Any]) -> Self:
        """Return some of the grasps, by a mask (n,) or indices."""
        return type(self)(*(getattr(self, name)[keep] for name in names_of(type(self))))

    @classmethod
    def concatenated(cls, parts: Sequence[Self]) -> Self:
        """Return all grasps of at least one part."""
        return cls(*(np.concatenate([getattr(p, name) for p in parts]) for name in names_of(cls)))


Labelled = TypeVar("Labelled", bound=LabelledGrasps)


def names_of(kind: type[LabelledGrasps]) -> tuple[str, ...]:
    """Return the names of what is kept of each grasp."""
    return tuple(field.name for field in fields(kind))  # type: ignore[arg-type]


class GraspFolder:
    """A folder of labelled grasps that is filled shard by shard."""

    def __init__(self, path: Path, identity: Mapping[str, Any]) -> None:
        """Open a folder, new or begun.

        Args:
            path: The folder.
            identity: What its grasps are made from: plain JSON.

        Raises:
            MechSearchError: If the folder holds grasps that were made from something else.
        """
        self.path = path
        self._manifest: dict[str, Any] = {"format": _FORMAT, **identity, "shards": {}}
        file = path / MANIFEST_FILE
        if file.exists():
            found = read_record(file, _PURPOSE, ("format", "shards"))
            if {**found, "shards": {}} != self._manifest:
                known = {**self._manifest, "shards": found["shards"]}
                differing = ", ".join(k for k, v in known.items() if found.get(k) != v)
                raise MechSearchError(
                    f"{path} holds grasps made from another {differing}; name another folder"
                )
            self._manifest = found

    def has(self, name: str) -> bool:
        """Return whether a shard is there, whole."""
        return _whole(self.path / name, self._manifest["shards"].get(name))

    def add(self, name: str, grasps: LabelledGrasps) -> None:
        """Write a shard and enter it into the manifest."""
        arrays = {field: getattr(grasps, field) for field in names_of(type(grasps))}
        file = self.path / name
        write_whole(file, lambda to: np.savez_compressed(to, allow_pickle=False, **arrays))
        self._manifest["shards"][name] = {
            "sha256": sha256(file),
            "grasps": len(grasps),
            "positive": int(grasps.success.sum()),
        }
        write_record(self.path / MANIFEST_FILE, _PURPOSE, self._manifest)

    def fill(
        self,
        heaps: Sequence[Heap],
        shard: int,
        label: Callable[[Heap], Labelled],
        kind: type[Labelled],
        workers: int,
        progress: Progress,
    ) -> None:
        """Label the grasps of all heaps whose shards are not there yet.

        Args:
            heaps: All of them.
            shard: Heaps in a file.
            label: Returns the grasps of a heap, a pure function that pickles.
            kind: What it returns.
            workers: Processes; the grasps do not depend on their number.
            progress: Told after each heap.
        """
        parts = [heaps[start : start + shard] for start in range(0, len(heaps), shard)]
        shards = {f"grasps-{number:05d}.npz": part for number, part in enumerate(parts)}
        missing = {name: part for name, part in shards.items() if not self.has(name)}
        tasks = list(chain.from_iterable(missing.values()))
        done = len(heaps) - len(tasks)
        progress("labelled heaps", done, len(heaps))
        labelled = map_in_order(label, tasks, workers)
        for name, part in missing.items():
            grasps = []
            for found in islice(labelled, len(part)):
                grasps.append(found)
                done += 1
                progress("labelled heaps", done, len(heaps))
            self.add(name, kind.concatenated(grasps))


def load_labelled(path: Path, kind: type[Labelled]) -> Labelled:
    """Return all grasps of a folder.

    Raises:
        MechSearchError: If there are none or others, or a shard is missing or damaged.
    """
    manifest = read_manifest(path)
    parts = []
    for name, entry in sorted(manifest["shards"].items()):
        shard = path / name
        if not _whole(shard, entry):
            raise MechSearchError(f"shard {shard} is missing or damaged; label again to replace it")
        arrays = read_arrays(shard, "shard of labelled grasps")
        if set(arrays) != set(names_of(kind)):
            raise MechSearchError(
                f"{path} holds grasps with {', '.join(sorted(arrays))}; expected "
                f"{', '.join(sorted(names_of(kind)))}"
            )
        parts.append(kind(**arrays))
    if not parts:
        raise MechSearchError(f"{path} holds no grasps yet")
    return kind.concatenated(parts)


def read_manifest(path: Path) -> dict[str, Any]:
    """Return what a folder holds, and from what it was made.

    Raises:
        MechSearchError: If there is no manifest, or it is damaged or of another version.
    """
    file = path / MANIFEST_FILE
    manifest = read_record(file, _PURPOSE, ("format", "shards"))
    if manifest["format"] != _FORMAT:
        raise MechSearchError(
            f"{file} is of labelled grasps of format {manifest['format']}; this version reads "
            f"{_FORMAT}"
        )
    return manifest


def sha256(path: Path) -> str:
    """Return the hash of a file's content."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _whole(path: Path, entry: Mapping[str, Any] | None) -> bool:
    return entry is not None and path.is_file() and sha256(path) == entry["sha256"]
