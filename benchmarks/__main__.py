"""Measure, merge into results.json and the documentation's table, and print both.

Run from the repository's root, on an otherwise idle machine: `python -m benchmarks`.
"""

import os

# Before anything starts threads: every stack gets one.
os.environ.setdefault("OMP_NUM_THREADS", "1")

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Annotated

import tyro

from benchmarks import machine
from benchmarks.results import Figure, Row, merge, row_of, to_markdown, write_table
from benchmarks.settings import Settings
from benchmarks.workload import ROOT, find_workload

RESULTS = ROOT / "benchmarks" / "results.json"
PAGE = ROOT / "docs" / "performance.md"

MEASUREMENTS = {
    "action": "action:measure",
    "share": "share:measure",
    "workers": "workers:measure",
    "starts": "starts:measure",
    "vector": "vector:measure",
    "looks": "looks:measure",
    "frames": "frames:measure",
    "generation": "generation:measure",
    "updates": "updates:measure",
    "grasping": "grasping:measure",
    "scaling": "scaling:measure",
    "decisions": "decisions:measure",
    "trust": "trust:measure",
    "robot": "robot:measure",
    "heaps-4200": "end_to_end:measure_heaps",
    "train-8000": "end_to_end:measure_training",
}
ORDER = (
    "action-5", "action-10", "action-15", "worker", "vector", "looks", "frames", "heaps-per-second",
    "heaps-4200", "updates", "train", "grasp", "robot", "physics", "frame-", "score",
    "overlap", "objects", "side",
)  # fmt: skip


@dataclass(frozen=True)
class Options:
    """What to measure.

    Attributes:
        names: Of the measurements; none means all.
        full: Also what takes long: whole heap sets and whole training runs.
        heaps: For each object count.
        out: File of the results.
        page: Page of the table.
    """

    names: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    full: bool = False
    heaps: int = 12
    out: Path = RESULTS
    page: Path = PAGE


def main() -> None:
    """Measure what was asked for; what is done is kept even if a later one fails."""
    options = tyro.cli(Options)
    unknown = [name for name in options.names if name not in MEASUREMENTS]
    if unknown:
        raise SystemExit(f"unknown {unknown[0]!r}; choose among {', '.join(MEASUREMENTS)}")
    settings = Settings(find_workload(), options.heaps, options.full)
    where = machine.describe()
    usable = len(settings.workload.heap_set.heaps)
    settings.say(f"{usable} {settings.workload.title} on {where}")
    rows: Sequence[Row] = ()
    for name in options.names or MEASUREMENTS:
        settings.say(f"measuring {name}")
        command = f"python -m benchmarks {name}" + (" --full" if options.full else "")
        new = [row_of(figure, where, command) for figure in _function(name)(settings)]
        rows = merge(options.out, new, ORDER)
        write_table(options.page, rows)
    print(to_markdown(rows))


def _function(name: str) -> Callable[[Settings], Iterator[Figure]]:
    module, _, function = MEASUREMENTS[name].partition(":")
    found: Callable[[Settings], Iterator[Figure]] = getattr(
        import_module(f"benchmarks.{module}"), function
    )
    return found


if __name__ == "__main__":
    main()
