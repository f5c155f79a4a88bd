"""What every command is: options that parse themselves, and a run."""

import importlib
import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self

import tyro

from mechsearch.files import check_place, write_whole
from mechsearch.processes import PROCESSORS, Mapper, map_in_order
from mechsearch.processes import bars as bars
from mechsearch.types import MechSearchError, check_extra

# What records and heaps are made of is no part of a robot's installation.
if TYPE_CHECKING:
    from mechsearch.evaluation.rollout import Evaluation

PICTURES = (".png", ".jpg", ".jpeg", ".webp")
"""Formats of pictures, by suffix."""

FLAT = tyro.conf.arg(name="")
"""Marks a record whose values are options of the command itself."""


class Command:
    """Options of one command; subclasses are frozen dataclasses."""

    writes: ClassVar[tuple[tuple[str, tuple[str, ...]], ...]] = ()
    """The options that name files to write, and the formats of each by suffix; none means any."""

    behind: ClassVar[tuple[type[Any], ...]] = ()
    """Records among the options that `--help` leaves to `--help-all`."""

    keeps: ClassVar[str] = ""
    """What an interruption leaves, of commands that go on from there when given again."""

    @classmethod
    def parse(cls, program: str, words: Sequence[str]) -> Self:
        """Return the options that words on the command line give."""
        options: Self = parsed(cls, program, words, cls.behind)
        return options

    def check_places(self) -> None:
        """Refuse files that could not be written in the end, before there is anything to write.

        Raises:
            MechSearchError: Naming the first.
        """
        for name, formats in self.writes:
            if place := getattr(self, name):
                check_place(place, formats)

    def run(self) -> None:
        """Do what the command is for."""
        raise NotImplementedError

    def interrupted(self, words: Sequence[str]) -> str:
        """Return what an interruption leaves, and how to go on.

        Args:
            words: Of the command line.
        """
        if not self.keeps:
            left, verb = "files already written are whole, nothing else is", "begin anew"
        else:
            left, verb = self.keeps, "go on"
        return f"{left} kept; {verb} by `{shlex.join(['mechsearch', *words])}`"


def parsed(
    kind: type[Any],
    program: str,
    words: Sequence[str],
    behind: Sequence[type[Any]] = (),
    **options: Any,
) -> Any:
    """Return the options that words on the command line give.

    Args:
        kind: A record of options.
        program: What is called, for the help.
        words: Of the command line.
        behind: Records of options in it that `--help` leaves to `--help-all`.
        options: Of `tyro.cli`, such as `default`.
    """
    everything = "--help-all" in words
    brief = bool(behind) and not everything and not {"-h", "--help"}.isdisjoint(words)
    registry = tyro.constructors.ConstructorRegistry()

    @registry.struct_rule
    def nothing(info: tyro.constructors.StructTypeInfo) -> Any:
        if not (brief and info.type in behind):
            return None
        return tyro.constructors.StructConstructorSpec(instantiate=info.type, fields=())

    args = ["--help"] if everything else list(words)
    try:
        return tyro.cli(kind, prog=program, args=args, registry=registry, **options)
    except SystemExit as end:
        if brief and not end.code:
            say(f"`{program} --help-all` also tells how every detail is changed.")
        raise


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

    def __post_init__(self) -> None:
        if self.workers < 1:
            raise MechSearchError(f"{self.workers} workers; expected at least 1")


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
        check_extra("work spread by --ray or --ray-address", "ray")
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

    def recorded(self) -> "Iterator[tuple[Path, Evaluation]]":
        """Yield each file and its episodes, whose objects must be at hand; see `models_of`."""
        from mechsearch.evaluation.rollout import load_some

        for path in self.episodes:
            evaluation = load_some(path, self.limit)
            models_of(evaluation, self.objects)
            yield path, evaluation


def models_of(evaluation: "Evaluation", named: str) -> Mapping[str, Any]:
    """Return the objects that an evaluation was recorded with, by name.

    Raises:
        MechSearchError: If the set that was named, or that the evaluation names, has others.
    """
    from mechsearch.heaps.dataset import recorded_objects

    name, hashes = str(evaluation.header["object_set"]), evaluation.header["object_hashes"]
    return recorded_objects("these episodes were recorded", name, hashes, named).models


def say(text: str) -> None:
    """Write a result."""
    print(text)


def say_table(caption: str, columns: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Write a table in plain columns; see `Table`."""
    from mechsearch.findings.tables import Table, to_text

    say(to_text(Table(caption, tuple(columns), tuple(map(tuple, rows)))))


def wrote(path: Path) -> None:
    """Tell where a result is."""
    say(f"wrote {path}")


def save(path: Path, write: Callable[[Path], object]) -> None:
    """Write a result to a file, whole or not at all, and tell where it is."""
    write_whole(path, write)
    wrote(path)
