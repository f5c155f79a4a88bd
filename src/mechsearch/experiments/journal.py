"""How far a sweep is: its journal, data for who watches on which no result depends, and status."""

import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mechsearch.experiments.folder import SweepFolder
from mechsearch.experiments.jobs import Job
from mechsearch.experiments.plan import read_plan
from mechsearch.experiments.schedule import chains_of
from mechsearch.files import CHECK_MARK, append_line, line_of, locked, record_of, write_text
from mechsearch.types import MechSearchError

SWEEP, BEGAN, ENDED, RAISED, FAILED = "sweep", "began", "ended", "raised", "failed"
"""Events of a journal."""

DONE, RUNNING, WAITING = "done", "running", "waiting"
STATES = (DONE, RUNNING, WAITING, FAILED)
"""What a job may be."""


@dataclass(frozen=True)
class Journal:
    """JSON lines, to which every process appends.

    Attributes:
        path: The file.
    """

    path: Path

    def write(self, event: str, **facts: Any) -> None:
        """Append an event."""
        append_line(self.path, {"event": event, "time": round(time.time(), 1), **facts})

    def records(self) -> list[dict[str, Any]]:
        """Return all events; a torn or damaged line is left out."""
        found = []
        text = self.path.read_text(encoding="utf-8", errors="replace") if self.path.exists() else ""
        # Earlier versions wrote no checksums.
        mark = CHECK_MARK if CHECK_MARK in text else ""
        for line in text.splitlines():
            with suppress(ValueError):
                record = record_of(line)
                if "event" in record and mark in line:
                    found.append(record)
        return found

    def begin(self, workers: int) -> None:
        """Note that a sweep begins: what was running before runs no longer."""
        kept = "".join(map(line_of, self.records()))
        write_text(self.path, kept)
        self.write(SWEEP, workers=workers)


@dataclass
class History:
    """What a journal tells of the past.

    Attributes:
        running: When each running job began, by name [s since the epoch].
        ended: Jobs that the present sweep has finished.
        failed: Why each job failed for good that was not tried again since, by name.
        seconds: How long each finished job took, by name.
        workers: Jobs at a time.
    """

    running: dict[str, float] = field(default_factory=dict)
    ended: set[str] = field(default_factory=set)
    failed: dict[str, str] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    workers: int = 1

    @classmethod
    def of(cls, records: Iterable[dict[str, Any]]) -> "History":
        """Read the events in their order."""
        past = cls()
        for record in records:
            past._take(record, str(record.get("job", "")))
        return past

    def _take(self, record: dict[str, Any], job: str) -> None:
        self.running.pop(job, None)
        event = record["event"]
        if event == SWEEP:
            self.running.clear()
            self.ended.clear()
            self.workers = int(record.get("workers", 1))
        elif event == BEGAN:
            self.running[job] = float(record.get("time", 0.0))
            self.failed.pop(job, None)
        elif event == ENDED:
            self.seconds[job] = float(record.get("seconds", 0.0))
            self.ended.add(job)
        elif event == FAILED:
            self.failed[job] = str(record.get("reason", ""))


@dataclass(frozen=True)
class JobStatus:
    """One job.

    Attributes:
        job: Which.
        state: "done", "running", "waiting" or "failed".
        reason: Why it failed, or what it waits for.
    """

    job: Job
    state: str
    reason: str = ""


@dataclass(frozen=True)
class SweepStatus:
    """All jobs, and how long the rest will take.

    Attributes:
        jobs: In the order of the schedule.
        hours_left: At the pace of the jobs that are done; NaN while none is.
    """

    jobs: tuple[JobStatus, ...]
    hours_left: float

    def count(self, state: str, kind: str = "") -> int:
        """Return the number of jobs in a state, of one kind or of all."""
        return sum(j.state == state and kind in ("", j.job.kind) for j in self.jobs)

    @property
    def line(self) -> str:
        """All of it in one line."""
        running = [status.job.name for status in self.jobs if status.state == RUNNING]
        parts = [f"{self.count(DONE)} of {len(self.jobs)} jobs done"]
        if failed := self.count(FAILED):
            parts.append(f"{failed} failed")
        if running:
            parts.append(f"at {', '.join(running)}")
        if self.hours_left == self.hours_left and self.count(DONE) < len(self.jobs):
            parts.append(f"about {self.hours_left:.1f} hours left")
        return "; ".join(parts)


def status_of(folder: SweepFolder) -> SweepStatus:
    """Return how far the sweep in a folder is, whether it is at work or not.

    Raises:
        MechSearchError: If there is no sweep.
    """
    jobs = [job for chain in chains_of(read_plan(folder), folder) for job in chain]
    with locked(folder.lock, wait=False) as nobody_works:
        past = History.of(Journal(folder.journal).records())
    done, wrong = inspected(jobs)
    if nobody_works:
        past.running.clear()
    return status(jobs, done, wrong, past)


def inspected(jobs: Sequence[Job]) -> tuple[set[str], dict[str, str]]:
    """Return the names of the jobs that are done, and what is wrong with the results of others."""
    done: set[str] = set()
    wrong: dict[str, str] = {}
    for job in jobs:
        try:
            if job.is_done():
                done.add(job.name)
        except MechSearchError as error:
            wrong[job.name] = str(error)
    return done, wrong


def status(
    jobs: Sequence[Job], done: set[str], wrong: dict[str, str], past: History
) -> SweepStatus:
    """Return the status from what is on disk and what the journal tells."""
    failed = {**past.failed, **wrong}
    found = []
    for job in jobs:
        if job.name in done:
            found.append(JobStatus(job, DONE))
        elif job.name in past.running:
            found.append(JobStatus(job, RUNNING))
        elif job.name in failed:
            found.append(JobStatus(job, FAILED, failed[job.name]))
        else:
            needs = [name for name in job.after if name not in done]
            found.append(JobStatus(job, WAITING, f"needs {', '.join(needs)}" if needs else ""))
    return SweepStatus(tuple(found), _hours_left(found, past))


def _hours_left(found: Sequence[JobStatus], past: History) -> float:
    """Return the time that waiting and running jobs will take at the pace of those that are done.

    What a job costs is known beforehand but for a factor, which the finished jobs of its kind
    tell, or else all finished jobs.
    """
    finished = [s.job for s in found if s.state == DONE and s.job.name in past.seconds]
    if not finished:
        return float("nan")
    seconds = 0.0
    for s in found:
        if s.state in (DONE, FAILED):
            continue
        alike = [job for job in finished if job.kind == s.job.kind] or finished
        pace = sum(past.seconds[job.name] for job in alike) / sum(job.cost for job in alike)
        spent = time.time() - past.running.get(s.job.name, time.time())
        seconds += max(s.job.cost * pace - spent, 0.0)
    return seconds / max(past.workers, 1) / 3600
