"""`mechsearch sweep`: all jobs of a plan, each once, whatever happens to the machine."""

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from mechsearch.evaluation.episodes import merge_summary, summary_rows
from mechsearch.experiments.curves import write_curves
from mechsearch.experiments.folder import SweepFolder
from mechsearch.experiments.job import Job
from mechsearch.experiments.journal import BEGAN, ENDED, FAILED, RAISED, Journal, Past
from mechsearch.experiments.plan import SweepPlan, open_plan
from mechsearch.experiments.schedule import Chain, chains_of, chosen, next_wave
from mechsearch.experiments.status import SweepStatus, inspected, status
from mechsearch.experiments.sweep import run_all
from mechsearch.experiments.trials import Grasp, Scoring, finished_runs
from mechsearch.files import NotWrittenError, locked
from mechsearch.processes import (
    Failure,
    Mapper,
    map_in_order,
)
from mechsearch.types import MechSearchError

JOB_LIMIT = 12 * 3600.0
"""Time after which a run and its evaluation hang [s]; they take minutes."""

LOOK_EVERY = 5.0
"""Time between two looks at the journal [s]."""

Tell = Callable[[SweepStatus], None]


@dataclass(frozen=True)
class CarryOut:
    """Carries out a chain in whichever process; what is done already is not done again."""

    journal: Journal

    def __call__(self, chain: Chain) -> str:
        """Return why the chain has stopped, if it met what trying again cannot mend; else ""."""
        for job in chain:
            try:
                self._carry_out(job)
            except MechSearchError as error:
                return str(error)
        return ""

    def _carry_out(self, job: Job) -> None:
        if job.is_done():
            return
        self.journal.write(BEGAN, job=job.name)
        began = time.monotonic()
        try:
            job.carry_out()
        except MechSearchError:
            raise
        except Exception as error:
            self.journal.write(RAISED, job=job.name, reason=f"{type(error).__name__}: {error}")
            raise
        self.journal.write(ENDED, job=job.name, seconds=round(time.monotonic() - began, 1))


def carry_out(
    plan: SweepPlan,
    path: Path,
    workers: int = 1,
    mapper: Mapper = map_in_order,
    grasp: Grasp | None = None,
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
        only: Patterns of the names of those jobs that are wanted now; all, if there are none.

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
            done, wrong = inspected([job for chain in chains for job in chain])
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
            results = run_all(CarryOut(journal), wave, workers, mapper=mapper, time_limit=JOB_LIMIT)
            tried |= set(wave)
            fresh, _ = inspected([job for chain in wave for job in chain])
            done |= fresh
            for chain, result in zip(wave, results, strict=True):
                stuck = [job.name for job in chain if job.name not in done]
                reason = result.reason if isinstance(result, Failure) else result
                if reason and stuck:
                    journal.write(FAILED, job=stuck[0], reason=reason)
    ended, wrong = inspected(jobs)
    done = done.difference(job.name for job in jobs) | ended
    _gather(plan, jobs, done, folder)
    past = Past.of(journal.records())
    past.running.clear()
    return status(jobs, done, wrong, past)


def _gather(plan: SweepPlan, jobs: Sequence[Job], done: set[str], folder: SweepFolder) -> None:
    """Enter what a kill between recording and entering may have left out of the tables."""
    for job in jobs:
        if isinstance(job, Scoring) and job.name in done:
            evaluation = job.recorded()
            if evaluation is not None:
                rows = summary_rows(job.plan.experiment, evaluation)
                merge_summary(folder.summary, rows)
    write_curves(folder.curves, finished_runs(plan, folder))


@contextmanager
def _watched(
    jobs: Sequence[Job], done: set[str], wrong: dict[str, str], journal: Journal, tell: Tell
) -> Iterator[None]:
    """Tell the status every few seconds while inside."""
    over = threading.Event()

    def watch() -> None:
        while not over.wait(LOOK_EVERY):
            past = Past.of(journal.records())
            tell(status(jobs, done | past.ended, wrong, past))

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
