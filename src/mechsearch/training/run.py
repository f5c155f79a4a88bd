"""A training run from files, and the record of what it was made from."""

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from mechsearch.algorithm import RunConfig
from mechsearch.files import (
    CONFIG_FILE,
    INPUTS_FILE,
    PROGRESS_FILE,
    alone,
    crossed,
    fingerprint,
    read_record,
    write_json,
    write_record,
)
from mechsearch.heaps.dataset import HeapSet, open_heaps
from mechsearch.processes import Mapper, Progress, map_in_order, silent
from mechsearch.training.assemble import assemble
from mechsearch.training.config import run_config
from mechsearch.training.loop import learn
from mechsearch.types import MechSearchError

_HISTORY = "fingerprints"
_PURPOSE = "record of a run's inputs"


@dataclass(frozen=True)
class RunInputs:
    """What a run is made from.

    Attributes:
        heaps: Heap set (.parquet); its training half is learnt on.
        objects: Object set; empty takes the one that the heaps name.
    """

    heaps: Path
    objects: str = ""

    @classmethod
    def of_run(cls, directory: Path) -> "RunInputs":
        """Return what a run was made from.

        Raises:
            MechSearchError: If it has no record of that.
        """
        record = _read(directory)
        return cls(directory / record["heaps"], record["objects"])


def train(
    config: RunConfig[Any] | str,
    heaps: str | Path,
    out: str | Path,
    objects: str = "",
    resume: bool = False,
    progress: Progress = silent,
    workers: int = 1,
    mapper: Mapper = map_in_order,
    **options: Any,
) -> dict[str, float]:
    """Train, and write the run directory; return the last evaluation.

    Args:
        config: The run, or the name of a variant or an algorithm, as `mechsearch train` takes it.
        heaps: Heap set (.parquet); its training half is learnt on.
        out: Run directory to write.
        objects: Object set; empty takes the one that the heaps name.
        resume: Go on from the last checkpoint.
        progress: Told as the run goes on.
        workers: Processes, where pushes are learnt; the run does not depend on their number.
        mapper: How work is spread over them.
        options: Of the run, by name, such as `actions=2000`, `seed=1` or `max_actions=30`.

    Raises:
        MechSearchError: If the inputs do not fit, the directory holds another run, or another
            process is at work in it.
    """
    run = (run_config(config) if isinstance(config, str) else config).changed(**options)
    directory, inputs = Path(out), RunInputs(Path(heaps), objects)
    with alone(directory / "run", f"the run {directory}"):
        heap_set, found = open_heaps(inputs.heaps, inputs.objects)
        _record(inputs, heap_set, directory, resume, fingerprint(run.schedule.threads))
        setup = replace(assemble(run, heap_set, found), workers=workers, mapper=mapper)
        return learn(run, setup, directory, resume, _Watched(directory, progress))


_KEPT_EVERY = 5.0
"""Time between two states of the progress on disk [s]."""


@dataclass
class _Watched:
    """Progress that is kept on disk too, where `mechsearch status` finds it."""

    directory: Path
    progress: Progress
    began: list[float] = field(default_factory=list)
    kept: float = 0.0

    def __call__(self, label: str, done: int, total: int) -> None:
        self.progress(label, done, total)
        now = time.time()
        self.began = self.began or [now, done]
        if now - self.kept >= _KEPT_EVERY or done >= total:
            self.kept = now
            state = {"label": label, "done": done, "total": total}
            told = {**state, "time": round(now, 1), "began": self.began}
            write_json(self.directory / PROGRESS_FILE, told)


def _read(directory: Path) -> dict[str, Any]:
    return read_record(directory / INPUTS_FILE, _PURPOSE, ("heaps", "heap_set", "objects"))


def crossings(directory: Path) -> list[str]:
    """Return what a run went on with instead of what it began with; see `files.crossed`."""
    history = _read(directory).get(_HISTORY, [])
    return [text for before, now in pairwise(history) for text in crossed(before, now)]


def _from(directory: Path, file: Path) -> str:
    """Return where a file is: as seen from the run, where both are in the folder of work.

    A repository that holds both can then lie anywhere.
    """
    here = Path.cwd()
    if directory.is_relative_to(here) and file.is_relative_to(here):
        return Path(os.path.relpath(file, directory)).as_posix()
    return str(file)


def _record(
    inputs: RunInputs,
    heap_set: HeapSet,
    directory: Path,
    resume: bool,
    now: Mapping[str, str],
) -> None:
    """Write what the run is made from, or check that it is made from the same.

    A run that goes on with other versions or on another processor keeps a record of them too.

    Raises:
        MechSearchError: If a run that goes on began with other heaps.
    """
    file = directory / INPUTS_FILE
    if resume:
        record = _read(directory)
        began, history = record["heap_set"], record.get(_HISTORY, [])
        if began != heap_set.hash:
            raise MechSearchError(
                f"{directory} began with the heap set {began[:12]}..., and {inputs.heaps} is "
                f"{heap_set.hash[:12]}...; go on with the same"
            )
        if history[-1:] != [now]:
            write_record(file, _PURPOSE, record | {_HISTORY: [*history, now]})
    elif not (directory / CONFIG_FILE).exists():
        record = {
            "heaps": _from(directory.resolve(), inputs.heaps.resolve()),
            "heap_set": heap_set.hash,
            "objects": inputs.objects or heap_set.objects,
            _HISTORY: [now],
        }
        write_record(file, _PURPOSE, record)
