"""A training run from files, and the record of what it was made from."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from mechsearch.files import alone, read_record, write_record
from mechsearch.files.fingerprint import crossed, fingerprint
from mechsearch.files.layout import CONFIG_FILE, INPUTS_FILE
from mechsearch.heaps.dataset import HeapSet, check_objects, load_heaps, object_set
from mechsearch.processes import Progress, silent
from mechsearch.train.assemble import assemble
from mechsearch.train.config import TrainConfig
from mechsearch.train.loop import train
from mechsearch.train.push_loop import learn_pushes
from mechsearch.types import MechSearchError

_HISTORY = "fingerprints"
_PURPOSE = "record of a run's inputs"


@dataclass(frozen=True)
class TrialInputs:
    """What a run is made from.

    Attributes:
        heaps: Heap set (.parquet); its training half is learnt on.
        objects: Object set; empty takes the one that the heaps name.
    """

    heaps: Path
    objects: str = ""

    @classmethod
    def of_run(cls, directory: Path) -> "TrialInputs":
        """Return what a run was made from.

        Raises:
            MechSearchError: If it has no record of that.
        """
        record = _read(directory)
        return cls(directory / record["heaps"], record["objects"])


def run_trial(
    config: TrainConfig,
    inputs: TrialInputs,
    directory: Path,
    resume: bool = False,
    progress: Progress = silent,
) -> dict[str, float]:
    """Train, and write the run directory; return the last evaluation.

    Args:
        config: The run.
        inputs: What it is made from.
        directory: Where it is written.
        resume: Go on from the last checkpoint.
        progress: Told as the run goes on.

    Raises:
        MechSearchError: If the inputs do not fit, the directory holds another run, or another
            process is at work in it.
    """
    with alone(directory / "run", f"the run {directory}"):
        return _run_alone(config, inputs, directory, resume, progress)


def _run_alone(
    config: TrainConfig, inputs: TrialInputs, directory: Path, resume: bool, progress: Progress
) -> dict[str, float]:
    heap_set = load_heaps(inputs.heaps)
    objects = object_set(inputs.objects or str(heap_set.manifest["config"]["objects"]))
    check_objects(heap_set, objects)
    _record(inputs, heap_set, directory, resume, fingerprint(config.threads))
    parts = assemble(config, heap_set, objects)
    learn = learn_pushes if config.pushes.networks else train
    return learn(config, parts, directory, resume, progress)


def _read(directory: Path) -> dict[str, Any]:
    return read_record(directory / INPUTS_FILE, _PURPOSE, ("heaps", "heap_set", "objects"))


def crossings(directory: Path) -> list[str]:
    """Return what a run went on with instead of what it began with; see `fingerprint.crossed`."""
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
    inputs: TrialInputs,
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
            "objects": inputs.objects or str(heap_set.manifest["config"]["objects"]),
            _HISTORY: [now],
        }
        write_record(file, _PURPOSE, record)
