"""Labelled grasps on disk: shards of arrays, and a manifest that says what made them."""

import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mechsearch.files import read_arrays, read_record, write_record, write_whole
from mechsearch.sim.lift import Outcome
from mechsearch.types import MechSearchError

_FORMAT = 1
_PURPOSE = "manifest of a grasp set"

MANIFEST_FILE = "grasps.json"
"""What a folder of labelled grasps holds, and from what they were made."""

OUTCOMES = tuple(Outcome)
"""What the outcome numbers of a grasp set mean."""


@dataclass(frozen=True, eq=False)
class Grasps:
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

    def __len__(self) -> int:
        return len(self.depth)

    @property
    def success(self) -> NDArray[np.bool_]:
        """The labels (n,)."""
        return np.asarray(self.outcome == OUTCOMES.index(Outcome.SUCCESS), np.bool_)

    @property
    def counts(self) -> Counter[str]:
        """How many grasps came to which outcome."""
        return Counter(str(OUTCOMES[number]) for number in self.outcome)

    def where(self, keep: NDArray[Any]) -> "Grasps":
        """Return some of the grasps, by a mask (n,) or indices."""
        return Grasps(*(getattr(self, name)[keep] for name in _FIELDS))

    @staticmethod
    def concatenated(parts: Sequence["Grasps"]) -> "Grasps":
        """Return all grasps of at least one part."""
        return Grasps(*(np.concatenate([getattr(p, name) for p in parts]) for name in _FIELDS))


_FIELDS = tuple(Grasps.__dataclass_fields__)


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

    def add(self, name: str, grasps: Grasps) -> None:
        """Write a shard and enter it into the manifest."""
        arrays = {field: getattr(grasps, field) for field in _FIELDS}
        file = self.path / name
        write_whole(file, lambda to: np.savez_compressed(to, allow_pickle=False, **arrays))
        self._manifest["shards"][name] = {
            "sha256": _sha256(file),
            "grasps": len(grasps),
            "positive": int(grasps.success.sum()),
        }
        write_record(self.path / MANIFEST_FILE, _PURPOSE, self._manifest)


def load_grasps(path: Path) -> Grasps:
    """Return all grasps of a folder.

    Raises:
        MechSearchError: If there are none, or a shard is missing or damaged.
    """
    file = path / MANIFEST_FILE
    manifest = read_record(file, _PURPOSE, ("format", "shards"))
    if manifest["format"] != _FORMAT:
        raise MechSearchError(
            f"{file} is of labelled grasps of format {manifest['format']}; this version reads "
            f"{_FORMAT}"
        )
    parts = []
    for name, entry in sorted(manifest["shards"].items()):
        shard = path / name
        if not _whole(shard, entry):
            raise MechSearchError(f"shard {shard} is missing or damaged; label again to replace it")
        parts.append(Grasps(**read_arrays(shard, "shard of labelled grasps")))
    if not parts:
        raise MechSearchError(f"{path} holds no grasps yet")
    return Grasps.concatenated(parts)


def _whole(path: Path, entry: Mapping[str, Any] | None) -> bool:
    return entry is not None and path.is_file() and _sha256(path) == entry["sha256"]


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
