"""What every command is: options that parse themselves, and a run."""

import importlib
import importlib.util
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Self

import tyro

from mechsearch.evaluation.episodes import Evaluation
from mechsearch.evaluation.rollout import load_some
from mechsearch.files import write_whole
from mechsearch.findings.tables import Table, to_text
from mechsearch.heaps.dataset import recorded_objects
from mechsearch.objects.model import ObjectModel
from mechsearch.processes import PROCESSORS, Mapper, map_in_order
from mechsearch.processes import bars as bars
from mechsearch.types import MechSearchError

FLAT = tyro.conf.arg(name="")
"""Marks a record whose values are options of the command itself."""


class Command:
    """Options of one command; subclasses are frozen dataclasses."""

    @classmethod
    def parse(cls, program: str, words: Sequence[str]) -> Self:
        """Return the options that words on the command line give."""
        return tyro.cli(cls, prog=program, args=list(words))

    def run(self) -> None:
        """Do what the command is for."""
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class OfObjects(Command):
    """A command about objects that a file names.

    Attributes:
        objects: Object set; the one that the file names by default.
    """

    objects: str = ""


@dataclass(frozen=True, kw_only=True)
class Parallel(Command):
    """A command of much work.

    Attributes:
        workers: Processes; what comes out does not depend on their number.
    """

    workers: int = PROCESSORS


@dataclass(frozen=True, kw_only=True)
class Spread(Parallel):
    """A command whose work can leave this machine.

    Attributes:
        ray: Spread the work by Ray instead.
        ray_address: Of a Ray cluster, all of whose processors work; "auto" finds one that runs.
    """

    ray: bool = False
    ray_address: str = ""

    @contextmanager
    def spread(self) -> Iterator[tuple[int, Mapper]]:
        """Yield the number of workers and the map: of this machine, or of a Ray cluster.

        Raises:
            MechSearchError: If Ray is not installed, or there is no such cluster.
        """
        if not self.ray and not self.ray_address:
            yield self.workers, map_in_order
            return
        if importlib.util.find_spec("ray") is None:
            raise MechSearchError("--ray and --ray-address need Ray: install mechsearch[ray]")
        cluster = importlib.import_module("mechsearch.processes.ray_cluster")
        with cluster.connected(self.ray_address, self.workers) as processors:
            yield processors, cluster.ray_map


@dataclass(frozen=True, kw_only=True)
class OfEpisodes(OfObjects, Parallel):
    """A command about recorded episodes.

    Attributes:
        episodes: Files that `mechsearch evaluate` wrote (.npz).
        limit: Number of episodes of each file, spread evenly; 0 takes all.
    """

    episodes: Annotated[
        tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="EPISODES [EPISODES ...]")
    ]
    limit: int = 0

    def recorded(self) -> Iterator[tuple[Path, Evaluation]]:
        """Yield each file and its episodes, whose objects must be at hand; see `models_of`."""
        for path in self.episodes:
            evaluation = load_some(path, self.limit)
            models_of(evaluation, self.objects)
            yield path, evaluation


def models_of(evaluation: Evaluation, named: str) -> Mapping[str, ObjectModel]:
    """Return the objects that an evaluation was recorded with, by name.

    Raises:
        MechSearchError: If the set that was named, or that the evaluation names, has others.
    """
    name, hashes = str(evaluation.header["object_set"]), evaluation.header["object_hashes"]
    return recorded_objects("these episodes were recorded", name, hashes, named).models


def say(text: str) -> None:
    """Write a result."""
    print(text)


def say_table(caption: str, columns: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Write a table in plain columns; see `Table`."""
    say(to_text(Table(caption, tuple(columns), tuple(map(tuple, rows)))))


def wrote(path: Path) -> None:
    """Tell where a result is."""
    say(f"wrote {path}")


def save(path: Path, write: Callable[[Path], object]) -> None:
    """Write a result to a file, whole or not at all, and tell where it is."""
    write_whole(path, write)
    wrote(path)
