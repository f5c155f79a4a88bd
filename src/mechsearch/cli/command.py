"""What every command is: options that parse themselves, and a run."""

import importlib
import importlib.util
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Self

import tyro

from mechsearch.evaluation.episodes import Evaluation
from mechsearch.heaps.dataset import object_set
from mechsearch.objects.model import ObjectModel
from mechsearch.processes import PROCESSORS, Mapper, map_in_order
from mechsearch.processes import bars as bars
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
def open_mapper(workers: int, ray: bool, address: str) -> Iterator[tuple[int, Mapper]]:
    """Yield the number of workers and the map: of this machine, or of a Ray cluster.

    Args:
        workers: Processes on this machine.
        ray: Whether to use Ray; its cluster is this machine alone without an address.
        address: Of a cluster, all of whose processors are used.

    Raises:
        MechSearchError: If Ray is not installed, or there is no such cluster.
    """
    if not ray and not address:
        yield workers, map_in_order
        return
    if importlib.util.find_spec("ray") is None:
        raise MechSearchError("--ray and --ray-address need Ray: install mechsearch[ray]")
    cluster = importlib.import_module("mechsearch.processes.ray_cluster")
    with cluster.connected(address, workers) as processors:
        yield processors, cluster.ray_map


def models_of(evaluation: Evaluation, named: str) -> Mapping[str, ObjectModel]:
    """Return the objects that an evaluation was recorded with, by name.

    Raises:
        MechSearchError: If the set that was named, or that the evaluation names, has others.
    """
    objects = object_set(named or str(evaluation.header["object_set"]))
    recorded = evaluation.header["object_hashes"]
    wrong = objects.differing(recorded)
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
