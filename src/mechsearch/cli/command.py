"""What every command is: options that parse themselves, and a run."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Self

import tyro
from rich.console import Console

from mechsearch.evaluation.episodes import Evaluation
from mechsearch.heaps.dataset import HeapSet
from mechsearch.objects.catalog import load_object_set, set_hashes
from mechsearch.objects.model import ObjectModel, ObjectSet
from mechsearch.parallel import PROCESSORS, Progress
from mechsearch.train.progress import progress_bars
from mechsearch.types import MechSearchError

WORKERS = PROCESSORS
"""Processes, unless a command says otherwise."""


class Command:
    """Options of one command; subclasses are frozen dataclasses."""

    @classmethod
    def parse(cls, program: str, words: Sequence[str]) -> Self:
        """Return the options that words on the command line give."""
        return tyro.cli(cls, prog=program, args=list(words))

    def run(self) -> None:
        """Do what the command is for."""
        raise NotImplementedError


@contextmanager
def bars() -> Iterator[Progress]:
    """Show progress on the error stream, once there is any, so that results can be piped."""
    with ExitStack() as stack:
        opened: list[Progress] = []

        def progress(label: str, done: int, total: int) -> None:
            if not opened:
                opened.append(stack.enter_context(progress_bars(Console(stderr=True))))
            opened[0](label, done, total)

        yield progress


def objects_of(heap_set: HeapSet, named: str) -> ObjectSet:
    """Return the object set that was named, or else the one that a heap set was made with."""
    return load_object_set(named or str(heap_set.manifest["config"]["objects"]))


def models_of(evaluation: Evaluation, named: str) -> Mapping[str, ObjectModel]:
    """Return the objects that an evaluation was recorded with, by name.

    Raises:
        MechSearchError: If the set that was named, or that the evaluation names, has others.
    """
    objects = load_object_set(named or str(evaluation.header["object_set"]))
    recorded, present = evaluation.header["object_hashes"], set_hashes(objects)
    wrong = sorted(name for name in recorded if present.get(name) != recorded[name])
    if wrong:
        raise MechSearchError(
            f"{len(wrong)} of the {len(recorded)} recorded objects are missing from or differ in "
            f"{objects.name!r}: {', '.join(wrong[:5])}; name the set they were recorded with, by "
            "--objects"
        )
    return objects.models


def say(text: str) -> None:
    """Write a result."""
    print(text)


def wrote(path: Path) -> None:
    """Tell where a result is."""
    say(f"wrote {path}")
