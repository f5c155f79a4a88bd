"""Training runs and final evaluations."""

import hashlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

from mechsearch.algorithm import RunConfig
from mechsearch.evaluation.episodes import (
    Evaluation,
    load_episodes,
    merge_summary,
    save_episodes,
    summary_rows,
)
from mechsearch.evaluation.policies import LOOK_AHEAD
from mechsearch.evaluation.rollout import EvaluationPlan, evaluate_plan, file_name
from mechsearch.experiments.curves import write_curves
from mechsearch.experiments.folder import SweepFolder
from mechsearch.experiments.job import Job
from mechsearch.experiments.plan import SweepPlan
from mechsearch.files import read_record, write_record
from mechsearch.files.layout import (
    CONFIG_FILE,
    FINISHED_FILE,
    INPUTS_FILE,
    METRICS_FILE,
    POLICY_FILE,
)
from mechsearch.training.config import load_config
from mechsearch.training.policies import load_policy
from mechsearch.training.run import train
from mechsearch.types import MechSearchError

Grasp = Callable[[Evaluation], Evaluation]
"""Adds to the episodes what a gripper could do with their targets; must pickle."""


@dataclass(frozen=True)
class Training(Job):
    """One training run.

    Attributes:
        variant: What is trained.
        seed: Of everything random in it.
    """

    variant: str
    seed: int

    @property
    def name(self) -> str:
        """Such as "single/method-seed0"."""
        return f"{self.condition}/{self.variant}-seed{self.seed}"

    @property
    def kind(self) -> str:
        """A training run."""
        return "training runs"

    @property
    def cost(self) -> float:
        """Actions and updates, or pushes tried and fits; and the points of the curve."""
        points = 1 + self.plan.actions // self.plan.curve_every
        action = 0.3 if self.variant == "plus" else 0.065
        episode = 0.35 + 0.3 * bool(self.config.schedule.grasp_network)
        return action * self.plan.actions + episode * self.plan.curve_heaps * points

    @property
    def directory(self) -> Path:
        """Its run directory."""
        return self.folder.run(self.condition, self.variant, self.seed)

    @property
    def config(self) -> RunConfig[Any]:
        """Its configuration."""
        return self.plan.config(self.variant, self.seed)

    @property
    def label(self) -> str:
        """Name, as a pattern, of the recorded episodes of the actor that it ended with."""
        return f"{self.variant}-seed{self.seed}-[0-9]*"

    @property
    def finished(self) -> dict[str, Any]:
        """What was written down when the run was over; empty as long as it is not.

        Raises:
            MechSearchError: If that is damaged.
        """
        file = self.directory / FINISHED_FILE
        return read_record(file, "record of a finished run", ("actor",)) if file.exists() else {}

    def is_done(self) -> bool:
        """Return whether the run is over, and its actor the one that it ended with.

        Once its episodes are recorded the actor may be gone: actors are most of a folder's size.
        """
        self._check_directory()
        finished = self.finished
        if not finished:
            return False
        actor = self.directory / POLICY_FILE
        log = self.directory / METRICS_FILE
        # Earlier versions kept no digest of the log.
        kept = {actor: finished.get("actor"), log: finished.get("metrics", _digest(log))}
        scored = any(self.folder.evaluations(self.condition).glob(f"{self.label}.npz"))
        if scored and not actor.exists():
            del kept[actor]
        for changed, digest in kept.items():
            if digest is None or _digest(changed) != digest:
                raise MechSearchError(
                    f"{changed} is not what the run ended with; delete "
                    f"{self.directory / FINISHED_FILE} to go on from the run's last checkpoint"
                )
        return True

    def _check_directory(self) -> None:
        """Refuse a directory that holds something else.

        Raises:
            MechSearchError: If it does.
        """
        if not self.directory.exists():
            return
        if not (self.directory / CONFIG_FILE).exists():
            found = {file.name for file in self.directory.iterdir() if file.name[0] != "."}
            if found - {INPUTS_FILE}:
                raise MechSearchError(
                    f"{self.directory} holds {', '.join(sorted(found)[:5])} and no {CONFIG_FILE}: "
                    "it is no run of this sweep; move it away"
                )
            return
        if load_config(self.directory / CONFIG_FILE) != self.config:
            raise MechSearchError(
                f"{self.directory} holds a run of another configuration than this sweep's; move it "
                "away"
            )
        began = read_record(self.directory / INPUTS_FILE, "record of a run's inputs")
        if self.heaps.exists() and began.get("heap_set") != self.heap_set.hash:
            raise MechSearchError(
                f"{self.directory} holds a run on other heaps than this sweep's; move it away"
            )

    def carry_out(self) -> None:
        """Train, from the last checkpoint if there is one, and renew the table of curves."""
        resume = (self.directory / CONFIG_FILE).exists()
        train(self.config, self.heaps, self.directory, self.plan.objects, resume)
        done = {
            "actor": _digest(self.directory / POLICY_FILE),
            "metrics": _digest(self.directory / METRICS_FILE),
            "training_actions": load_policy(self.directory).training_actions,
        }
        write_record(self.directory / FINISHED_FILE, "record of a finished run", done)
        write_curves(self.folder.curves, finished_runs(self.plan, self.folder))


def finished_runs(plan: SweepPlan, folder: SweepFolder) -> Iterator[Path]:
    """Yield the directories of the runs of a plan that are over, and no foreign ones."""
    for condition, variant, seed in product(plan.conditions, plan.variants, plan.seeds):
        run = Training(plan, folder, condition, variant, seed)
        with suppress(MechSearchError):
            if run.is_done():
                yield run.directory


@dataclass(frozen=True)
class Scoring(Job):
    """A final evaluation on held-out heaps.

    Attributes:
        grasp: What measures graspability and retrieval, where the plan asks for it.
    """

    grasp: Grasp | None

    @property
    def name(self) -> str:
        """Such as "single/scores of idle"."""
        return f"{self.condition}/scores of {self._label}"

    @property
    def kind(self) -> str:
        """Scores."""
        return "scores"

    @property
    def cost(self) -> float:
        """A third of a second for each heap, seconds where pushes or grasps are tried."""
        planning = 2.5 if self._policy == LOOK_AHEAD else 0.0
        return self.plan.final_heaps * (0.35 + planning + 1.5 * self.plan.grasps)

    @property
    def _label(self) -> str:
        raise NotImplementedError

    @property
    def _policy(self) -> str:
        raise NotImplementedError

    @property
    def _expected(self) -> dict[str, Any]:
        """What the header of the recorded episodes must say."""
        return {
            "heap_set": self.heap_set.hash,
            "split": "held-out",
            "heaps": self.plan.final_heaps,
            "seed": 0,
        }

    @property
    def _mark(self) -> dict[str, str]:
        """What is entered into that header besides what an evaluation says of itself."""
        return {}

    def files(self) -> list[Path]:
        """Return the recorded episodes that are there; more than one are too many."""
        return sorted(self.folder.evaluations(self.condition).glob(f"{self._label}.npz"))

    def recorded(self) -> Evaluation | None:
        """Return the recorded episodes, if they are there.

        Raises:
            MechSearchError: If they are damaged, or not of this sweep.
        """
        files = self.files()
        if not files or not self.heaps.exists():
            return None
        if len(files) > 1:
            names = ", ".join(file.name for file in files)
            raise MechSearchError(f"{files[0].parent} holds {names}; expected one of them")
        evaluation = load_episodes(files[0])
        mark = self._mark
        for key, value in (self._expected | mark).items():
            # Earlier versions left no mark.
            found = evaluation.header.get(key, mark.get(key))
            if found != value:
                raise MechSearchError(
                    f"{files[0]} is not of this sweep: its {key.replace('_', ' ')} is "
                    f"{found!r}; expected {value!r}; move it away"
                )
        if self.plan.grasps and "grasp_network" not in evaluation.header:
            raise MechSearchError(f"{files[0]} is without grasps; move it away")
        return evaluation

    def is_done(self) -> bool:
        """Return whether the episodes are recorded."""
        return self.recorded() is not None

    def carry_out(self) -> None:
        """Record the episodes, and enter their scores into the summary."""
        evaluation = evaluate_plan(
            EvaluationPlan(
                self._policy, self.heaps, objects=self.plan.objects, limit=self.plan.final_heaps
            )
        )
        if self.plan.grasps:
            if self.grasp is None:
                raise MechSearchError("the plan asks for grasps, and nothing to measure them given")
            evaluation = self.grasp(evaluation)
        evaluation = replace(evaluation, header={**evaluation.header, **self._mark})
        place = self.folder.evaluations(self.condition)
        save_episodes(place / f"{file_name(evaluation)}.npz", evaluation)
        merge_summary(self.folder.summary, summary_rows(self.plan.experiment, evaluation))


@dataclass(frozen=True)
class ReferenceScoring(Scoring):
    """The evaluation of a policy that is not trained.

    Attributes:
        policy: As `make_policy` knows it.
    """

    policy: str

    @property
    def _label(self) -> str:
        return self.policy

    @property
    def _policy(self) -> str:
        return self.policy


@dataclass(frozen=True)
class RunScoring(Scoring):
    """The evaluation of the actor that a run ended with.

    Attributes:
        training: The run.
    """

    training: Training

    @property
    def name(self) -> str:
        """Such as "single/scores of method-seed0"."""
        return f"{self.condition}/scores of {self.training.variant}-seed{self.training.seed}"

    @property
    def after(self) -> tuple[str, ...]:
        """The run."""
        return (self.training.name,)

    @property
    def _label(self) -> str:
        return self.training.label

    @property
    def _policy(self) -> str:
        return str(self.training.directory)

    @property
    def _expected(self) -> dict[str, Any]:
        run = {"name": self.training.variant, "training_seed": self.training.seed}
        if finished := self.training.finished:
            run["training_actions"] = finished["training_actions"]
        return super()._expected | run

    @property
    def _mark(self) -> dict[str, str]:
        """The digest of the actor: a run that was made anew may have ended with another one."""
        finished = self.training.finished
        return {"actor": finished["actor"]} if finished else {}

    def is_done(self) -> bool:
        """Return whether the episodes are recorded, and of the actor that the run ended with."""
        return bool(self.training.finished) and super().is_done()


def _digest(path: Path) -> str | None:
    if not path.exists():
        return None
    return hashlib.sha256(path.read_bytes()).hexdigest()
