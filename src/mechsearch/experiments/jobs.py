"""What a sweep is cut into: heap sets, training runs and final evaluations."""

import hashlib
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any, ClassVar

from mechsearch.algorithm import RunConfig
from mechsearch.env import HeapEnvConfig, task_from_json
from mechsearch.evaluation.episodes import (
    Evaluation,
    load_episodes,
    merge_summary,
    save_episodes,
    summary_rows,
)
from mechsearch.evaluation.policies import LOOK_AHEAD
from mechsearch.evaluation.rollout import EvaluationPlan, differing, evaluate_plan, file_name
from mechsearch.experiments.folder import SweepFolder, write_curves
from mechsearch.experiments.plan import SweepPlan
from mechsearch.files import (
    CHECKPOINTS_FOLDER,
    CONFIG_FILE,
    FINISHED_FILE,
    INPUTS_FILE,
    METRICS_FILE,
    POLICY_FILE,
    SCORES_SUFFIX,
    read_content,
    read_record,
    write_record,
)
from mechsearch.findings.scores import compact, episode_files, load_scores, scores_file
from mechsearch.heaps.dataset import HeapSet, load_heaps
from mechsearch.heaps.generate import generate
from mechsearch.training.config import load_config
from mechsearch.training.run import train
from mechsearch.training.run_directory import load_policy
from mechsearch.types import MechSearchError

GraspAssessor = Callable[[Evaluation], Evaluation]
"""Adds to the episodes what a gripper could do with their targets; must pickle."""

_FINISHED = "record of a finished run"


@dataclass(frozen=True)
class Job:
    """One unit of work that can be redone by itself; subclasses say which.

    A job that was cut off goes on, or begins anew, when it is carried out again.

    Attributes:
        kind: What it is, in words; jobs of one kind are equally much dearer than their cost.
        plan: Of the sweep.
        folder: Where everything is kept.
        condition: "single" or "dual".
        again: Whether the actor and the episodes, which may be removed once there are scores, are
            wanted again where they are gone.
    """

    kind: ClassVar[str]
    plan: SweepPlan
    folder: SweepFolder
    condition: str
    again: bool = field(default=False, kw_only=True)

    @property
    def name(self) -> str:
        """What tells it from the sweep's other jobs."""
        raise NotImplementedError

    @property
    def after(self) -> tuple[str, ...]:
        """Names of the jobs that must be done before."""
        return (f"{self.condition}/heaps",) if not self.plan.heap_file(self.condition) else ()

    @property
    def cost(self) -> float:
        """About how long it takes on one core of 2025 [s]; only ratios matter in the end."""
        raise NotImplementedError

    def is_done(self) -> bool:
        """Return whether its result is there.

        Raises:
            MechSearchError: If something else, or something damaged, is in its place.
        """
        raise NotImplementedError

    def carry_out(self) -> None:
        """Do it, in one thread.

        Raises:
            MechSearchError: If something else is in its place, or its inputs do not fit.
        """
        raise NotImplementedError

    @property
    def heaps(self) -> Path:
        """File of the condition's heap set."""
        return Path(self.plan.heap_file(self.condition) or self.folder.heaps(self.condition))

    @property
    def heap_set(self) -> HeapSet:
        """The condition's heap set."""
        state = self.heaps.stat()
        return _loaded(self.heaps, state.st_mtime_ns, state.st_size)

    def episodes(self, title: str) -> list[Path]:
        """Return the files of recorded episodes, or of episodes whose scores alone are left.

        Args:
            title: How their names begin, as a pattern.
        """
        place = self.folder.evaluations(self.condition)
        found = [file for end in (".npz", SCORES_SUFFIX) for file in place.glob(title + end)]
        return sorted(episode_files(found))


@dataclass(frozen=True)
class HeapGeneration(Job):
    """Generates a heap set where none is given."""

    kind = "heap sets"

    @property
    def name(self) -> str:
        """Such as "single/heaps"."""
        return f"{self.condition}/heaps"

    @property
    def after(self) -> tuple[str, ...]:
        """Nothing."""
        return ()

    @property
    def cost(self) -> float:
        """A quarter of a second for each heap."""
        return 0.25 * self.plan.generated(self.condition).heaps

    def is_done(self) -> bool:
        """Return whether the heap set is there."""
        if not self.heaps.exists():
            return False
        config = self.plan.generated(self.condition)
        found = self.heap_set.manifest["config"]
        names = ("condition", "heaps", "objects", "seed", "camera")
        if any(found[name] != getattr(config, name) for name in names):
            raise MechSearchError(f"{self.heaps} is not of this sweep; move it away")
        return True

    def carry_out(self) -> None:
        """Generate it; what was generated before it was cut off is kept."""
        generate(self.plan.generated(self.condition), self.heaps)


@dataclass(frozen=True)
class Training(Job):
    """One training run.

    Attributes:
        variant: What is trained, as the plan names it.
        seed: Of everything random in it.
    """

    kind = "training runs"
    variant: str
    seed: int

    @property
    def title(self) -> str:
        """Such as "method-seed0"."""
        return f"{self.config.name}-seed{self.seed}"

    @property
    def name(self) -> str:
        """Such as "single/method-seed0"."""
        return f"{self.condition}/{self.title}"

    @property
    def cost(self) -> float:
        """A tenth of a second for each action, whatever the algorithm; and the curve's episodes."""
        points = 1 + self.plan.actions // self.plan.curve_every
        episode = 0.35 + 0.3 * bool(self.config.schedule.grasp_network)
        return 0.1 * self.plan.actions + episode * self.plan.curve_heaps * points

    @property
    def directory(self) -> Path:
        """Its run directory."""
        return self.folder.run(self.condition, self.title)

    @property
    def config(self) -> RunConfig[Any]:
        """Its configuration."""
        return self.plan.config(self.variant, self.seed)

    @property
    def finished(self) -> dict[str, Any]:
        """What was written down when the run was over; empty as long as it is not.

        Raises:
            MechSearchError: If that is damaged.
        """
        file = self.directory / FINISHED_FILE
        return read_record(file, _FINISHED, ("actor",)) if file.exists() else {}

    def is_done(self) -> bool:
        """Return whether the run is over, and its actor the one that it ended with.

        Once it is scored the actor may be gone: actors are most of a folder's size.
        """
        self._check_directory()
        finished = self.finished
        if not finished:
            return False
        actor, log = self.directory / POLICY_FILE, self.directory / METRICS_FILE
        # Earlier versions kept no digest of the log.
        kept = {actor: finished["actor"], log: finished.get("metrics", _digest(log))}
        if not actor.exists():
            if self.again:
                return False
            if self.episodes(f"{self.title}-[0-9]*"):
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
        config, inputs, wrong = self.directory / CONFIG_FILE, self.directory / INPUTS_FILE, ""
        if not config.exists():
            files = self.directory.iterdir() if self.directory.exists() else ()
            found = sorted(file.name for file in files if file.name[0] != ".")
            if set(found) - {INPUTS_FILE}:
                wrong = f"holds {', '.join(found[:5])} and no {CONFIG_FILE}: it is no run"
        elif load_config(config) != self.config:
            wrong = "holds a run of another configuration than that"
        elif self.heaps.exists():
            began = read_record(inputs, "record of a run's inputs")
            if began.get("heap_set") != self.heap_set.hash:
                wrong = "holds a run on other heaps than those"
        if wrong:
            raise MechSearchError(f"{self.directory} {wrong} of this sweep; move it away")

    def carry_out(self) -> None:
        """Train, from the last checkpoint if there is one, and renew the table of curves."""
        if self.finished:
            # Its actor was removed. From the last checkpoint there would be nothing left to do.
            (self.directory / FINISHED_FILE).unlink()
            shutil.rmtree(self.directory / CHECKPOINTS_FOLDER, ignore_errors=True)
        resume = (self.directory / CONFIG_FILE).exists()
        train(self.config, self.heaps, self.directory, self.plan.objects, resume)
        done = {
            "actor": _digest(self.directory / POLICY_FILE),
            "metrics": _digest(self.directory / METRICS_FILE),
            "training_actions": load_policy(self.directory).training_actions,
        }
        write_record(self.directory / FINISHED_FILE, _FINISHED, done)
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
        subject: The run whose last actor is scored, or a policy that is not trained, as
            `make_policy` knows it.
        grasp: What measures graspability and retrieval, where the plan asks for it.
    """

    kind = "scores"
    subject: Training | str
    grasp: GraspAssessor | None = None

    @property
    def name(self) -> str:
        """Such as "single/scores of method-seed0" or "single/scores of idle"."""
        run = self.subject
        return f"{self.condition}/scores of {run if isinstance(run, str) else run.title}"

    @property
    def after(self) -> tuple[str, ...]:
        """The run, or the heaps."""
        return super().after if isinstance(self.subject, str) else (self.subject.name,)

    @property
    def cost(self) -> float:
        """A third of a second for each heap, seconds where pushes or grasps are tried."""
        planning = 2.5 if self.subject == LOOK_AHEAD else 0.0
        return self.plan.final_heaps * (0.35 + planning + 1.5 * self.plan.grasps)

    @property
    def files(self) -> list[Path]:
        """The recorded episodes that are there or were scored; more than one are too many."""
        run = self.subject
        return self.episodes(run if isinstance(run, str) else f"{run.title}-[0-9]*")

    @property
    def _mark(self) -> dict[str, str]:
        """The digest of the actor: a run that was made anew may have ended with another one."""
        return {} if isinstance(self.subject, str) else {"actor": self.subject.finished["actor"]}

    def is_done(self) -> bool:
        """Return whether the episodes, or their scores, are of this plan and the run's actor."""
        run, found = self.subject, self.files
        if not (found and self.heaps.exists() and (isinstance(run, str) or run.finished)):
            return False
        if len(found) > 1:
            names = ", ".join(file.name for file in found)
            raise MechSearchError(f"{found[0].parent} holds {names}; expected one of them")
        (file,) = found
        if self.again and not file.exists():
            return False
        if file.exists():
            self._check(file, load_episodes(file).header)
        else:
            self._check(scores_file(file), load_scores(scores_file(file)).header)
        return True

    def _check(self, file: Path, header: Mapping[str, Any]) -> None:
        """Refuse episodes that are not of this sweep.

        Raises:
            MechSearchError: Naming the first fact that differs.
        """
        run, heap_set = self.subject, self.heap_set.hash
        expected: dict[str, Any] = {"heap_set": heap_set, "split": "held-out", "seed": 0}
        expected["heaps"] = self.plan.final_heaps
        if isinstance(run, Training):
            expected |= {"name": run.config.name, "training_seed": run.seed}
            expected["training_actions"] = run.finished["training_actions"]
        # Earlier versions left no mark.
        expected |= {key: mark for key, mark in self._mark.items() if key in header}
        wrong = [
            f"its {key.replace('_', ' ')} is {header.get(key)!r}; expected {value!r}"
            for key, value in expected.items()
            if header.get(key) != value
        ]
        task = task_from_json(HeapEnvConfig, header["env"])
        wrong += [f"its task is another, {change}" for change in differing(self.plan.task, task)]
        if wrong:
            raise MechSearchError(f"{file} is not of this sweep: {wrong[0]}; move it away")
        if self.plan.grasps and "grasp_network" not in header:
            raise MechSearchError(f"{file} is without grasps; move it away")

    def carry_out(self) -> None:
        """Record the episodes, and enter their scores; train again if the actor is gone."""
        run, plan = self.subject, self.plan
        if isinstance(run, Training) and not (run.directory / POLICY_FILE).exists():
            run.carry_out()
        policy = run if isinstance(run, str) else str(run.directory)
        evaluation = evaluate_plan(
            EvaluationPlan(
                *(policy, self.heaps), objects=plan.objects, limit=plan.final_heaps, task=plan.task
            )
        )
        if plan.grasps:
            if self.grasp is None:
                raise MechSearchError("the plan asks for grasps, and nothing to measure them given")
            evaluation = self.grasp(evaluation)
        place = self.folder.evaluations(self.condition)
        save_episodes(place / f"{file_name(evaluation)}.npz", evaluation)
        self.enter()

    def enter(self) -> None:
        """Enter the scores of the recorded episodes beside them and into the summary."""
        found = self.files
        recorded = [file for file in found if file.exists()]
        for file in recorded:
            if _digest_of_scored(file) != _digest(file):
                compact(file)
            rows = summary_rows(self.plan.experiment, load_episodes(file))
            merge_summary(self.folder.summary, rows)
        # Scores of an actor that was trained again, to another number of actions.
        for file in found if recorded else ():
            if not file.exists():
                scores_file(file).unlink()


@lru_cache(maxsize=4)
def _loaded(path: Path, modified: int, size: int) -> HeapSet:
    """Return a heap set, read once as long as its file stays the same."""
    return load_heaps(path)


def _digest(path: Path) -> str | None:
    content = read_content(path)
    return None if content is None else hashlib.sha256(content).hexdigest()


def _digest_of_scored(file: Path) -> str:
    """Return the digest of the episodes that the scores beside them are of; empty without any."""
    with suppress(MechSearchError):
        return load_scores(scores_file(file)).digest
    return ""
