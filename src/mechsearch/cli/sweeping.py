"""`mechsearch sweep`; needs PyTorch."""

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from mechsearch.cli.command import Spread, say, say_table, wrote
from mechsearch.cli.overrides import optional, overridden
from mechsearch.cli.status import run_status
from mechsearch.env import TaskConfig
from mechsearch.experiments.folder import SweepFolder
from mechsearch.experiments.plan import QUICK, SweepPlan, described, read_plan
from mechsearch.experiments.sweep import DONE, RUNNING, STATES, SweepStatus, carry_out, status_of
from mechsearch.retrieval.assessment import assessor

_PlanOptions: Any = optional(SweepPlan, ("task",))


@dataclass(frozen=True)
class Sweep(Spread):
    """Carry out every experiment of the paper's section V, or go on where that was cut off.

    What is not said is as the folder's own plan has it, or for a new folder as in the paper.

    Attributes:
        out: Folder for everything.
        quick: A small version of it: fewer seeds, variants, actions and heaps.
        status: Say how far it is, and do nothing.
        plan: What is carried out.
        only: Names of the jobs to carry out now, such as 'single/method-seed*'; all by default.
            What they name is made again if its actor or episodes were removed.
    """

    behind = (optional(TaskConfig),)
    keeps = "finished jobs, and the checkpoints of others, are"

    out: Path
    quick: bool = False
    status: bool = False
    plan: Annotated[Any, tyro.conf.arg(constructor=_PlanOptions, name="")] = field(
        default_factory=_PlanOptions
    )
    only: tuple[str, ...] = ()

    def run(self) -> None:
        """Carry the plan out; exit with 1 if something of it is missing in the end."""
        folder = SweepFolder(self.out)
        if self.status:
            say_status(self.out)
            return
        begun = folder.plan.exists() and not self.quick
        base = read_plan(folder) if begun else QUICK if self.quick else SweepPlan()
        plan = overridden(base, self.plan)
        say_table(f"The sweep in {self.out}", ("what", "value"), described(plan))
        # A network that is no good is refused before hours of work rather than after them.
        network = Path(plan.grasp_network) if plan.grasp_network else None
        grasp = assessor(network) if plan.grasps else None
        with self.spread() as (workers, mapper):
            found = carry_out(plan, self.out, workers, mapper, grasp, _Teller(), self.only)
        _report(found)
        wrote(folder.summary)
        wrote(folder.curves)
        if found.count(DONE) < len(found.jobs):
            raise SystemExit(1)


def say_status(out: Path) -> bool:
    """Say how far the sweep in a folder is; return whether somebody is at work in it.

    Raises:
        MechSearchError: If there is no sweep.
    """
    folder = SweepFolder(out)
    found = status_of(folder)
    _report(found)
    running = [one.job.name for one in found.jobs if one.state == RUNNING]
    for condition, _, title in (name.partition("/") for name in running):
        if folder.run(condition, title).is_dir():
            say(run_status(folder.run(condition, title))[0])
    return bool(running)


class _Teller:
    """Writes one line on the error stream when something has changed."""

    def __init__(self) -> None:
        self._last: tuple[object, ...] = ()

    def __call__(self, found: SweepStatus) -> None:
        states = tuple(status.state for status in found.jobs)
        if states != self._last:
            print(found.line, file=sys.stderr, flush=True)
        self._last = states


def _report(found: SweepStatus) -> None:
    """Say how many jobs of each kind are in which state, and what is wrong with some."""
    kinds = list(dict.fromkeys(one.job.kind for one in found.jobs))
    rows = [(kind, *(str(found.count(state, kind)) for state in STATES)) for kind in kinds]
    rows.append(("all", *(str(found.count(state)) for state in STATES)))
    say_table(found.line, ("jobs", *STATES), rows)
    for one in found.jobs:
        if one.reason:
            say(f"{one.state}: {one.job.name}: {' '.join(one.reason.split())}")
