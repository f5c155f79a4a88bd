"""How far a sweep is."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

from mechsearch.experiments.folder import SweepFolder
from mechsearch.experiments.job import Job
from mechsearch.experiments.journal import Journal, Past
from mechsearch.experiments.plan import read_plan
from mechsearch.experiments.schedule import chains_of
from mechsearch.files import locked
from mechsearch.types import MechSearchError

DONE, RUNNING, WAITING, FAILED = "done", "running", "waiting", "failed"
STATES = (DONE, RUNNING, WAITING, FAILED)


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
        past = Past.of(Journal(folder.journal).records())
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


def status(jobs: Sequence[Job], done: set[str], wrong: dict[str, str], past: Past) -> SweepStatus:
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


def _hours_left(found: Sequence[JobStatus], past: Past) -> float:
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
