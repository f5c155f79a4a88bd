"""`mechsearch sweep`: all jobs of a plan, each once, whatever happens to the machine."""

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from mechsearch.experiments.folder import SweepFolder, write_curves
from mechsearch.experiments.jobs import GraspAssessor, Job, Scoring, finished_runs
from mechsearch.experiments.journal import (
    BEGAN,
    ENDED,
    FAILED,
    RAISED,
    History,
    Journal,
    SweepStatus,
    inspected,
    status,
)
from mechsearch.experiments.plan import SweepPlan, open_plan
from mechsearch.experiments.schedule import Chain, chains_of, chosen, next_wave
from mechsearch.files import NotWrittenError, locked
from mechsearch.processes import Failure, Mapper, map_in_order
from mechsearch.types import MechSearchError

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
