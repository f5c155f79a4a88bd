"""`mechsearch sweep`: all jobs of a plan, each once, whatever happens to the machine.

First their order, then how far a sweep is: its journal, on which no result depends, and status.
"""

import fnmatch
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any

from mechsearch.experiments.folder import SweepFolder, write_curves
from mechsearch.experiments.jobs import (
    GraspAssessor,
    HeapGeneration,
    Job,
    Scoring,
    Training,
    finished_runs,
)
from mechsearch.experiments.plan import SweepPlan, open_plan, read_plan
from mechsearch.files import (
    CHECK_MARK,
    NotWrittenError,
    append_line,
    line_of,
    locked,
    record_of,
    write_text,
)
from mechsearch.processes import Failure, Mapper, map_in_order
from mechsearch.types import MechSearchError

Chain = tuple[Job, ...]
"""Jobs that are carried out one after another by the same worker."""


def chains_of(
    plan: SweepPlan, folder: SweepFolder, grasp: GraspAssessor | None = None
) -> list[Chain]:
    """Return all jobs of a plan, a run and its evaluation in one chain.

    What others need comes first. Runs come seed by seed, so that a sweep that is cut off has
    compared all variants on some seeds, rather than some variants on all seeds.
    """
    chains: list[Chain] = [
        (HeapGeneration(plan, folder, condition),)
        for condition in plan.conditions
        if not plan.heap_file(condition)
    ]
    for condition, policy in product(plan.conditions, plan.references):
        chains.append((Scoring(plan, folder, condition, policy, grasp),))
    for seed, variant, condition in product(plan.seeds, plan.variants, plan.conditions):
        run = Training(plan, folder, condition, variant, seed)
        chains.append((run, Scoring(plan, folder, condition, run, grasp)))
    return chains


def chosen(chains: Sequence[Chain], only: Sequence[str]) -> list[Chain]:
    """Return the chains with those of their jobs alone that are wanted, if need be again.

    Args:
        chains: All, in their order.
        only: Patterns of names, such as "single/method-seed*"; none wants all.

    Raises:
        MechSearchError: If a pattern is no job's.
    """
    if not only:
        return list(chains)
    names = [job.name for chain in chains for job in chain]
    wanted: set[str] = set()
    for pattern in only:
        found = fnmatch.filter(names, pattern)
        if not found:
            raise MechSearchError(
                f"no job of this sweep is called {pattern!r}; there are {len(names)}, from "
                f"{names[0]!r} to {names[-1]!r}"
            )
        wanted |= set(found)
    kept = (
        tuple(replace(job, again=True) for job in chain if job.name in wanted) for chain in chains
    )
    return [chain for chain in kept if chain]


def next_wave(chains: Sequence[Chain], done: Collection[str], tried: set[Chain]) -> list[Chain]:
    """Return the chains to carry out next: what others wait for, or else all that need not wait.

    Args:
        chains: All, in their order.
        done: Names of the jobs that are done.
        tried: Chains that were carried out, whether or not they failed.
    """
    left = [c for c in chains if c not in tried and not all(job.name in done for job in c)]
    ready = [chain for chain in left if _needs(chain) <= set(done)]
    needed = {name for chain in left for name in _needs(chain)} - set(done)
    first = [chain for chain in ready if any(job.name in needed for job in chain)]
    return first or ready


def _needs(chain: Chain) -> set[str]:
    """Return the names of the jobs of other chains that a chain needs."""
    return {name for job in chain for name in job.after} - {job.name for job in chain}


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


JOB_LIMIT = 12 * 3600.0
"""Time after which a run and its evaluation hang [s]; they take minutes."""

LOOK_EVERY = 5.0
"""Time between two looks at the journal [s]."""

Tell = Callable[[SweepStatus], None]


@dataclass(frozen=True)
class ChainRunner:
    """Carries out a chain in whichever process; what is done already is not done again."""

    journal: Journal

    def __call__(self, chain: Chain) -> str:
        """Return why the chain has stopped, if it met what trying again cannot mend; else ""."""
        for job in chain:
            try:
                if not job.is_done():
                    self._carry_out(job)
            except MechSearchError as error:
                return str(error)
            except Exception as error:
                self.journal.write(RAISED, job=job.name, reason=f"{type(error).__name__}: {error}")
                raise
        return ""

    def _carry_out(self, job: Job) -> None:
        self.journal.write(BEGAN, job=job.name)
        began = time.monotonic()
        job.carry_out()
        self.journal.write(ENDED, job=job.name, seconds=round(time.monotonic() - began, 1))


def carry_out(
    plan: SweepPlan,
    path: Path,
    workers: int = 1,
    mapper: Mapper = map_in_order,
    grasp: GraspAssessor | None = None,
    tell: Tell = lambda status: None,
    only: Sequence[str] = (),
) -> SweepStatus:
    """Carry out a plan in a folder, or what is left of it; return how far it is.

    A job whose worker dies, or that raises, is carried out once more; if it fails again, it and
    what needs it are left, the others go on, and its status has the reason.

    Args:
        plan: What to do.
        path: Folder for everything.
        workers: Jobs at a time, one process each.
        mapper: How jobs are spread: on this machine, or over a Ray cluster that sees the folder.
        grasp: Measures graspability and retrieval, where the plan asks for it.
        tell: Told the status now and then, from another thread.
        only: Patterns of the names of those jobs that are wanted now; all, if there are none. What
            they name is made again if its actor or episodes were removed.

    Raises:
        MechSearchError: If another sweep works in the folder, the folder is of another plan, or a
            pattern is no job's.
    """
    folder = SweepFolder(path)
    try:
        with locked(folder.lock, wait=False) as free:
            if not free:
                raise MechSearchError(
                    f"another sweep is at work in {path}; wait for its end, or stop it"
                )
            open_plan(plan, folder)
            chains = chains_of(plan, folder, grasp)
            wanted = chosen(chains, only)
            # What is wanted now may need what was done before.
            jobs = {job.name: job for chain in (*chains, *wanted) for job in chain}
            done, wrong = inspected(list(jobs.values()))
            return _carry_out_all(plan, wanted, done, wrong, folder, workers, mapper, tell)
    except (OSError, NotWrittenError) as error:
        raise MechSearchError(
            f"the sweep in {path} has stopped: {error}; what is finished is whole, and the same "
            "command goes on from here"
        ) from error


def _carry_out_all(
    plan: SweepPlan,
    chains: Sequence[Chain],
    done: set[str],
    wrong: dict[str, str],
    folder: SweepFolder,
    workers: int,
    mapper: Mapper,
    tell: Tell,
) -> SweepStatus:
    jobs = [job for chain in chains for job in chain]
    journal = Journal(folder.journal)
    journal.begin(workers)
    tried: set[Chain] = set()
    with _watched(jobs, done, wrong, journal, tell):
        while wave := next_wave(chains, done, tried):
            results = list(mapper(ChainRunner(journal), wave, workers, JOB_LIMIT, _reason, 1))
            tried |= set(wave)
            fresh, _ = inspected([job for chain in wave for job in chain])
            done |= fresh
            for chain, reason in zip(wave, results, strict=True):
                stuck = [job.name for job in chain if job.name not in done]
                if reason and stuck:
                    journal.write(FAILED, job=stuck[0], reason=reason)
    ended, wrong = inspected(jobs)
    done = done.difference(job.name for job in jobs) | ended
    _gather(plan, jobs, done, folder)
    past = History.of(journal.records())
    past.running.clear()
    return status(jobs, done, wrong, past)


def _reason(chain: Chain, failure: Failure) -> str:
    return failure.reason


def _gather(plan: SweepPlan, jobs: Sequence[Job], done: set[str], folder: SweepFolder) -> None:
    """Enter what a kill between recording and entering may have left out of the tables."""
    for job in jobs:
        if isinstance(job, Scoring) and job.name in done:
            job.enter()
    write_curves(folder.curves, finished_runs(plan, folder))


@contextmanager
def _watched(
    jobs: Sequence[Job], done: set[str], wrong: dict[str, str], journal: Journal, tell: Tell
) -> Iterator[None]:
    """Tell the status every few seconds while inside."""
    over = threading.Event()

    def watch() -> None:
        while not over.wait(LOOK_EVERY):
            past = History.of(journal.records())
            tell(status(jobs, done | past.ended, wrong, past))

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
