"""A folder of experiments as tables of numbers: who was scored on which heap, and how it went.

The folder has `sweep.json`, and for each condition `evaluations/*.npz` and
`runs/<variant>-seed<k>/`. Recorded poses are dropped as soon as they are measured.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mechsearch.evaluation.episodes import Evaluation, load_episodes
from mechsearch.evaluation.metrics import measure
from mechsearch.files import read_record
from mechsearch.files.layout import CONFIG_FILE, METRICS_FILE, PLAN_FILE
from mechsearch.report.curves import Run, read_run
from mechsearch.report.failure_modes import Behaviour, behaviour
from mechsearch.types import Floats, MechSearchError

VARIANTS = ("method", "plus", "ddpg", "no-teachers", "no-asymmetry", "no-pose-input")
PASSIVE = ("idle", "random")
TEACHER_PREFIX = "teacher-"
CEILING = "look-ahead"
Item = TypeVar("Item")
_FACTS = ("name", "condition", "heap_set", "split", "trained", "training_actions", "seed")


@dataclass(frozen=True)
class Trial:
    """One policy, trained once or not at all, on the heaps of one condition.

    Attributes:
        name: Of the policy.
        seed: Training seed, or evaluation seed where nothing was trained.
        actions: Training actions.
        trained: Whether it learnt.
        header: How the episodes came about.
        path: File of the episodes.
        heaps: Seeds of the heaps (H,), ascending.
        counts: Objects in each heap (H,).
        values: Each metric on every heap (H,).
        behaviours: How the episode on every heap went (H).
    """

    name: str
    seed: int
    actions: int
    trained: bool
    header: Mapping[str, Any]
    path: Path
    heaps: NDArray[np.int64]
    counts: NDArray[np.int64]
    values: Mapping[str, Floats]
    behaviours: tuple[Behaviour, ...]


@dataclass(frozen=True)
class Condition:
    """Everything that was run on one kind of heaps.

    Attributes:
        name: Such as "single".
        trials: Of each policy, one for each seed; those that learnt first, then teachers.
        runs: Of each variant, one for each seed.
    """

    name: str
    trials: Mapping[str, tuple[Trial, ...]]
    runs: Mapping[str, tuple[Run, ...]]

    @property
    def teachers(self) -> list[str]:
        """Names of the teachers that were scored."""
        return [name for name in self.trials if name.startswith(TEACHER_PREFIX)]

    @property
    def passive(self) -> list[str]:
        """Names of the policies that do nothing useful."""
        return [name for name in self.trials if name in PASSIVE]

    @property
    def counts(self) -> list[int]:
        """Numbers of objects in a heap."""
        trials = (trial for found in self.trials.values() for trial in found)
        return sorted({int(count) for trial in trials for count in trial.counts})

    def measured(self, name: str, metric: str) -> bool:
        """Return whether a policy has values of a metric for every seed."""
        trials = self.trials.get(name, ())
        return bool(trials) and all(metric in trial.values for trial in trials)

    def matrices(self, names: Sequence[str], metric: str, count: int | None = None) -> list[Floats]:
        """Return each policy's values (S, H) by seed and heap, on the heaps that all share.

        Args:
            names: Policies that were scored.
            metric: That all of them have.
            count: Of objects, to take those heaps alone.

        Raises:
            MechSearchError: If there is no heap that all ran on.
        """
        trials = [trial for name in names for trial in self.trials[name]]
        shared = trials[0].heaps
        if count is not None:
            shared = shared[trials[0].counts == count]
        for trial in trials:
            shared = np.intersect1d(shared, trial.heaps)
        if not len(shared):
            raise MechSearchError(
                f"{', '.join(names)} share no {self.name} heap; a comparison needs the same heaps"
            )
        return [
            np.array(
                [t.values[metric][np.searchsorted(t.heaps, shared)] for t in self.trials[name]]
            )
            for name in names
        ]


@dataclass(frozen=True)
class Experiment:
    """All conditions, and what the plan asked for.

    Attributes:
        folder: Where it was read from.
        plan: Content of `sweep.json`.
        conditions: By name.
    """

    folder: Path
    plan: Mapping[str, Any]
    conditions: Mapping[str, Condition]

    @property
    def missing(self) -> list[str]:
        """What the plan asks for and the folder has no scores of, such as "single: ddpg-seed3"."""
        plan = self.plan
        found = {
            (condition.name, f"{trial.name}-seed{trial.seed}" if trial.trained else trial.name)
            for condition in self.conditions.values()
            for trials in condition.trials.values()
            for trial in trials
        }
        runs = [f"{v}-seed{s}" for v in plan.get("variants", ()) for s in plan.get("seeds", ())]
        expected = {
            (str(condition), str(name))
            for condition in plan.get("conditions", ())
            for name in (*runs, *plan.get("references", ()))
        }
        return [f"{condition}: {name}" for condition, name in sorted(expected - found)]


def is_experiment(folder: Path) -> bool:
    """Return whether a folder holds a sweep's plan."""
    return (folder / PLAN_FILE).is_file()


def read_experiment(folder: Path) -> Experiment:
    """Read everything that a sweep wrote.

    Raises:
        MechSearchError: If a file is damaged or belongs elsewhere, or nothing was scored yet.
    """
    plan = read_record(folder / PLAN_FILE, "plan of a sweep")
    if not isinstance(plan, dict):
        raise MechSearchError(f"{folder / PLAN_FILE} is not the plan of a sweep")
    folders = sorted(
        (path for path in folder.iterdir() if (path / "evaluations").is_dir()),
        key=lambda path: (path.name != "single", path.name),
    )
    conditions = {path.name: _condition(path) for path in folders}
    conditions = {name: c for name, c in conditions.items() if c.trials}
    if not conditions:
        raise MechSearchError(f"no evaluation (.npz) in {folder}/*/evaluations yet")
    return Experiment(folder, plan, conditions)


def ordered(names: Iterable[str]) -> list[str]:
    """Return policies in the order of reports: the method, variants, teachers, ceiling, passive."""

    def rank(name: str) -> tuple[int, int, str]:
        if name in VARIANTS:
            return 0, VARIANTS.index(name), name
        teacher, ceiling = name.startswith(TEACHER_PREFIX), name == CEILING
        return (2 if teacher else 3 if ceiling else 4 if name in PASSIVE else 1), 0, name

    return sorted(names, key=rank)


def _condition(folder: Path) -> Condition:
    trials = [
        _trial(path, load_episodes(path)) for path in sorted((folder / "evaluations").glob("*.npz"))
    ]
    for trial in trials:
        _check(trial, folder.name, trials[0])
    groups = _grouped(_longest(trials), lambda trial: trial.name)
    runs_folder = folder / "runs"
    directories = sorted(runs_folder.iterdir()) if runs_folder.is_dir() else []
    # A run that has just begun has no log yet.
    runs = [_run(path) for path in directories if (path / METRICS_FILE).exists()]
    return Condition(folder.name, groups, _grouped(runs, lambda run: run.name))


def _trial(path: Path, evaluation: Evaluation) -> Trial:
    header = evaluation.header
    lacking = [fact for fact in _FACTS if fact not in header]
    if lacking:
        raise MechSearchError(f"{path} does not say its {', '.join(lacking)}")
    records = sorted(evaluation.episodes, key=lambda record: record.heap_seed)
    heaps = np.array([record.heap_seed for record in records], np.int64)
    if len(np.unique(heaps)) != len(heaps):
        raise MechSearchError(f"{path} has more than one episode on a heap")
    measured = [measure(record) for record in records]
    metrics = [name for name in measured[0] if all(name in values for values in measured)]
    seed = header.get("training_seed") if header["trained"] else header["seed"]
    return Trial(
        name=str(header["name"]),
        seed=int(seed or 0),
        actions=int(header["training_actions"]),
        trained=bool(header["trained"]),
        header=header,
        path=path,
        heaps=heaps,
        counts=np.array([record.count for record in records], np.int64),
        values={name: np.array([values[name] for values in measured]) for name in metrics},
        behaviours=tuple(behaviour(record) for record in records),
    )


def _check(trial: Trial, condition: str, first: Trial) -> None:
    if trial.header["condition"] != condition:
        raise MechSearchError(
            f"{trial.path} is of {trial.header['condition']} heaps; this folder is for {condition}"
        )
    for fact in ("heap_set", "split"):
        if trial.header[fact] != first.header[fact]:
            raise MechSearchError(
                f"{trial.path} has {fact} {trial.header[fact]} and {first.path.name} has "
                f"{first.header[fact]}; expected the same in one condition"
            )


def _longest(trials: Iterable[Trial]) -> list[Trial]:
    """Return for each policy and seed the trial after most training."""
    kept: dict[tuple[str, int], Trial] = {}
    for trial in trials:
        other = kept.get((trial.name, trial.seed))
        if other and other.actions == trial.actions:
            raise MechSearchError(
                f"{other.path} and {trial.path.name} are both {trial.name}, seed {trial.seed}, "
                f"after {trial.actions:,} actions; expected one of them"
            )
        if other is None or trial.actions > other.actions:
            kept[trial.name, trial.seed] = trial
    return [kept[key] for key in sorted(kept)]


def _run(directory: Path) -> Run:
    run = read_run(directory)
    if directory.name != f"{run.name}-seed{run.seed}":
        raise MechSearchError(
            f"{directory} holds the run {run.name}-seed{run.seed} by its {CONFIG_FILE}; expected "
            "the run that the folder is named after"
        )
    return run


def _grouped(items: Sequence[Item], name: Callable[[Item], str]) -> dict[str, tuple[Item, ...]]:
    names = ordered({name(item) for item in items})
    return {one: tuple(item for item in items if name(item) == one) for one in names}
