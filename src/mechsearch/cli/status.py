"""`mechsearch status`: what others are at, read from their folders."""

import importlib
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Annotated, Any

import tyro

from mechsearch.cli.command import Command, check_extra, say, say_table
from mechsearch.files import CONFIG_FILE, PLAN_FILE, PROGRESS_FILE, locked, read_json
from mechsearch.findings.experiment import EVALUATIONS, Run, read_run
from mechsearch.findings.tables import DISPLAYS, number


@dataclass(frozen=True)
class Status(Command):
    """Say how far runs and sweeps are: actions, rate, time left, last scores.

    It reads their folders alone, and disturbs nobody who is at work there.

    Attributes:
        folders: Run directories, or folders of sweeps.
        every: Say it again after so many seconds, until nobody is at work; 0 says it once.
    """

    folders: Annotated[
        tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER [FOLDER ...]")
    ]
    every: float = 0.0

    def run(self) -> None:
        """Say it."""
        while any([self._said(folder) for folder in self.folders]) and self.every > 0:
            time.sleep(self.every)

    def _said(self, folder: Path) -> bool:
        """Say how far one folder is; return whether somebody is at work there."""
        if (folder / PLAN_FILE).is_file():
            check_extra(f"the status of the sweep in {folder}", "learn")
            sweeping = importlib.import_module("mechsearch.cli.sweeping")
            return bool(sweeping.say_status(folder))
        run = read_run(folder)
        line, at_work = run_status(folder, run)
        rows = list(_scores(run))
        if rows:
            names = [DISPLAYS[name].label for name in rows[0][1]]
            say_table(line, ("scored on", "at", *names), [(a, *b) for a, _, b in rows])
        else:
            say(line)
        return at_work

    def interrupted(self, words: object) -> str:
        """Return what an interruption leaves."""
        del words
        return "nobody was disturbed"


def run_status(folder: Path, run: Run | None = None) -> tuple[str, bool]:
    """Return how far a run is in one line, and whether somebody is at work on it.

    Raises:
        MechSearchError: If the run's files are damaged.
    """
    if not (folder / CONFIG_FILE).is_file():
        return f"{folder}: about to begin", True
    run = run or read_run(folder)
    name = f"{folder}: {run.name}, seed {run.seed}"
    with locked(folder / "run", wait=False) as free:
        pass
    if not (folder / PROGRESS_FILE).is_file():
        last = max((int(r["step"]) for kind in run.records.values() for r in kind), default=0)
        return f"{name}: {last:,} actions", not free
    told: dict[str, Any] = read_json(folder / PROGRESS_FILE, "progress of a run")
    done, total = int(told["done"]), int(told["total"])
    parts = [f"{name}: {done:,} of {total:,} actions ({done / max(total, 1):.0%})"]
    if not free:
        parts.append(", ".join(["at work", *told["label"].split(", ")[1:]]))
        began, first = told["began"]
        if done > first:
            rate = (done - first) / (told["time"] - began)
            left = max((total - done) / rate - (time.time() - told["time"]), 0)
            parts.append(f"{rate:.2g} actions a second, {timedelta(seconds=round(left))} left")
    elif done < total:
        parts.append(f"stopped; go on by `mechsearch train --resume {folder}`")
    else:
        parts.append("finished")
    return "; ".join(parts), not free


def _scores(run: Run) -> Iterator[tuple[str, tuple[str, ...], tuple[str, ...]]]:
    """Yield on what a run was scored last, the names of the scores, and when and how."""
    for kind, heaps in EVALUATIONS.items():
        if records := run.records.get(kind):
            last = records[-1]
            names = tuple(name for name in last if name in DISPLAYS)
            values = (number(name, last[name]) for name in names)
            yield heaps, names, (f"{last['step']:,} actions", *values)
