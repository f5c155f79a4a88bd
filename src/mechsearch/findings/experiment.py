"""Who was scored on which heaps, and how it went: a sweep's folder, or evaluations found anywhere.

A sweep's folder has its plan, and for each condition the evaluations and the runs. Evaluations that
no plan ties together are an experiment too, of the conditions that are found among them.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from mechsearch.evaluation.episodes import (
    GRASP_METRICS,
    METRICS,
    RETRIEVAL_METRICS,
    SHARES,
    Estimate,
    mean_interval,
    share_interval,
)
from mechsearch.files import (
    CONFIG_FILE,
    EVALUATIONS_FOLDER,
    INPUTS_FILE,
    METRICS_FILE,
    PLAN_FILE,
    RUNS_FOLDER,
    read_lines,
    read_record,
)
from mechsearch.findings.bootstrap import estimated
from mechsearch.findings.scores import ScoredPolicy, episode_files, read_scored
from mechsearch.findings.tables import RETRIEVAL_TRADEOFF, TRADEOFF
from mechsearch.types import Floats, MechSearchError

LISTED_FIRST = (
    *("method", "plus", "as-printed", "ddpg", "no-teachers", "no-asymmetry", "no-pose-input"),
)
PASSIVE = ("idle", "random")
TEACHER_PREFIX = "teacher-"
CEILING = "look-ahead"
_LOG = f"{METRICS_FILE}*"
"""As it is, or packed."""
Item = TypeVar("Item")
VALIDATION = "validation"
EVALUATIONS = {"held_out": "held-out heaps", VALIDATION: "validation heaps"}
"""What a run scores itself on while it learns, those of more weight first."""

CURVE_COLUMNS = (
    *("condition", "variant", "seed", "scored_on", "step", "metric"),
    *("mean", "ci_low", "ci_high", "heaps"),
)


@dataclass(frozen=True)
class Run:
    """What a training run logged.

    Attributes:
        name: Of the run's configuration.
        seed: Likewise.
        records: Lines of the log by their kind, such as "validation" or "episode".
        heap_set: Digest of the heaps that it learnt from; empty if it does not say.
    """

    name: str
    seed: int
    records: Mapping[str, Sequence[Mapping[str, Any]]]
    heap_set: str = ""

    def series(self, kind: str, key: str, over: str = "step") -> tuple[Floats, Floats]:
        """Return steps, or another number, and values (n,) of one number in one kind of record."""
        pairs = [(r[over], r[key]) for r in self.records.get(kind, ()) if key in r]
        steps, values = np.array(pairs, np.float64).reshape(-1, 2).T
        return steps, values

    def keys(self, kind: str) -> list[str]:
        """Return the names of all numbers in one kind of record, in their first order."""
        items = (item for record in self.records.get(kind, ()) for item in record.items())
        names = dict.fromkeys(name for name, value in items if isinstance(value, int | float))
        return [name for name in names if name != "step"]


@dataclass(frozen=True)
class LearningCurve:
    """One metric of one variant while it learns.

    Attributes:
        steps: Training actions at each evaluation (K,).
        seeds: Value of each training seed (S, K).
    """

    steps: Floats
    seeds: Floats

    @property
    def means(self) -> list[Estimate]:
        """Mean over seeds at each step (K), with Student's t interval where there are several."""
        return [mean_interval(values) for values in self.seeds.T]


@dataclass(frozen=True)
class Condition:
    """Everything that was run on one kind of heaps, to uncover targets or to retrieve them.

    Attributes:
        name: Such as "single"; of retrieval that no plan ties together "single-retrieval".
        policies: Each policy's scores, one for each seed; those that learnt first, then teachers.
        runs: Of each variant, one for each seed.
    """

    name: str
    policies: Mapping[str, tuple[ScoredPolicy, ...]]
    runs: Mapping[str, tuple[Run, ...]]

    @property
    def scored(self) -> list[ScoredPolicy]:
        """Every policy and seed."""
        return [one for seeds in self.policies.values() for one in seeds]

    @property
    def retrieves(self) -> bool:
        """Whether targets are to be retrieved, and not uncovered only."""
        return any(one.retrieves for one in self.scored)

    @property
    def heaps(self) -> str:
        """What it is of in words, such as "single heaps" or "retrieval from single heaps"."""
        kind = next((str(one.header["condition"]) for one in self.scored), self.name)
        return f"{'retrieval from ' if self.retrieves else ''}{kind} heaps"

    @property
    def metrics(self) -> tuple[str, ...]:
        """Names of the scores, but for reward terms and grasps."""
        return RETRIEVAL_METRICS if self.retrieves else METRICS

    @property
    def headline(self) -> str:
        """The score by which policies are ranked."""
        return "retrieved_within_5" if self.retrieves else "reward"

    @property
    def tradeoff(self) -> tuple[str, str]:
        """Two scores that are held against each other."""
        return RETRIEVAL_TRADEOFF if self.retrieves else TRADEOFF

    @property
    def learnt(self) -> list[str]:
        """Names of the policies that learnt."""
        return [name for name, seeds in self.policies.items() if seeds[0].trained]

    @property
    def subjects(self) -> list[str]:
        """Names of the policies that learnt, or else of the best by the headline."""
        best = max(self.policies, key=lambda name: self.matrices([name], self.headline)[0].mean())
        return self.learnt or [best]

    @property
    def teachers(self) -> list[str]:
        """Names of the teachers that were scored."""
        return [name for name in self.policies if name.startswith(TEACHER_PREFIX)]

    @property
    def counts(self) -> list[int]:
        """Numbers of objects in a heap."""
        return sorted({int(count) for one in self.scored for count in one.counts})

    def measured(self, metric: str, *names: str) -> bool:
        """Return whether all these policies have values of a metric for every seed."""
        seeds = [self.policies.get(name, ()) for name in names]
        return all(seeds) and all(metric in one.values for policy in seeds for one in policy)

    @property
    def terms(self) -> list[str]:
        """Metrics that are terms of the reward."""
        names = dict.fromkeys(metric for one in self.scored for metric in one.values)
        return [name for name in names if name.startswith("term_")]

    def matrices(self, names: Sequence[str], metric: str, count: int | None = None) -> list[Floats]:
        """Return each policy's values (S, H) by seed and heap, on the heaps that all share.

        Args:
            names: Policies that were scored.
            metric: That all of them have.
            count: Of objects, to take those heaps alone.

        Raises:
            MechSearchError: If there is no heap that all ran on.
        """
        scored = [one for name in names for one in self.policies[name]]
        first = scored[0]
        shared = first.heaps if count is None else first.heaps[first.counts == count]
        for one in scored:
            shared = np.intersect1d(shared, one.heaps)
        if not len(shared):
            raise MechSearchError(
                f"{', '.join(names)} share no {self.name} heap; a comparison needs the same heaps"
            )
        return [
            np.array(
                [o.values[metric][np.searchsorted(o.heaps, shared)] for o in self.policies[name]]
            )
            for name in names
        ]

    def estimate(self, name: str, metric: str, count: int | None = None) -> Estimate | None:
        """Return a policy's mean over seeds and heaps; None where it was not measured.

        Args:
            name: Of the policy.
            metric: Which mean.
            count: Of objects, to take those heaps alone.
        """
        asked = (name, metric, count)
        if asked not in self._estimates:
            self._estimates[asked] = self._estimated(*asked)
        return self._estimates[asked]

    @cached_property
    def _estimates(self) -> dict[tuple[str, str, int | None], Estimate | None]:
        """What was estimated: figures and tables ask for the same."""
        return {}

    def _estimated(self, name: str, metric: str, count: int | None) -> Estimate | None:
        seeds = self.policies[name]
        present = count is None or all((one.counts == count).any() for one in seeds)
        if not present or not self.measured(metric, name):
            return None
        values = self.matrices([name], metric, count)[0]
        # Outcomes that are all alike leave a bootstrap nothing to draw from.
        if metric in SHARES and set(values.ravel().tolist()) in ({0.0}, {1.0}):
            return share_interval(values.mean(axis=0))
        found = estimated([values])
        if metric not in SHARES:
            return found
        # Of few seeds an interval may end beyond what a share can be.
        return replace(found, ci_low=max(0.0, found.ci_low), ci_high=min(1.0, found.ci_high))

    def scores_of(
        self, name: str, metrics: Iterable[str] = METRICS, count: int | None = None
    ) -> dict[str, Estimate]:
        """Return those means of a policy that were measured, by metric; see `estimate`."""
        found = {metric: self.estimate(name, metric, count) for metric in metrics}
        return {metric: mean for metric, mean in found.items() if mean}


@dataclass(frozen=True)
class Experiment:
    """All conditions, and what the plan asked for.

    Attributes:
        plan: Of a sweep; None for evaluations that no plan ties together.
        conditions: By name.
    """

    plan: Mapping[str, Any] | None
    conditions: Mapping[str, Condition]

    def condition(self, name: str) -> Condition:
        """Return a condition; one in which nothing was scored if there is none of that name."""
        return self.conditions.get(name) or Condition(name, {}, {})

    @property
    def runs(self) -> list[Run]:
        """Every run of every condition."""
        return [run for c in self.conditions.values() for seeds in c.runs.values() for run in seeds]

    @property
    def scored_on(self) -> str:
        """Which evaluations the curves show: on held-out heaps, wherever a run has them."""
        return next((k for k in EVALUATIONS if any(run.records.get(k) for run in self.runs)), "")

    @property
    def missing(self) -> list[str]:
        """What the plan asks for and the folder has no scores of, such as "single: ddpg-seed3"."""
        plan = self.plan or {}
        # An algorithm that is named `package.module:factory` is reported as `factory`.
        variants = [str(variant).rpartition(":")[2] for variant in plan.get("variants", ())]
        runs = [f"{v}-seed{s}" for v in variants for s in plan.get("seeds", ())]
        expected = {
            f"{condition}: {name}"
            for condition in plan.get("conditions", ())
            for name in (*runs, *plan.get("references", ()))
        }
        found = {
            f"{condition.name}: {one.name}" + (f"-seed{one.seed}" if one.trained else "")
            for condition in self.conditions.values()
            for one in condition.scored
        }
        return sorted(expected - found)


def read_experiment(*sources: Path) -> Experiment:
    """Read a sweep's folder, or everything that was evaluated and trained under some places.

    Raises:
        MechSearchError: If a file is damaged or belongs elsewhere, nothing was scored, or a sweep's
            folder is not the only source.
    """
    if not any((source / PLAN_FILE).is_file() for source in sources):
        return _loose(sources)
    if len(sources) > 1:
        raise MechSearchError(f"{len(sources)} sources; a sweep's folder is reported by itself")
    (folder,) = sources
    plan = read_record(folder / PLAN_FILE, "plan of a sweep")
    conditions = [_planned(path) for path in folder.iterdir() if path.is_dir()]
    conditions = [condition for condition in conditions if condition.policies]
    if not conditions:
        raise MechSearchError(f"no evaluation (.npz) in {folder}/*/{EVALUATIONS_FOLDER} yet")
    return Experiment(plan, _by_name(conditions))


def read_run(directory: Path) -> Run:
    """Read a run directory.

    Raises:
        MechSearchError: If it holds no run, or its log is damaged.
    """
    config = read_record(directory / CONFIG_FILE, "training configuration")
    inputs = directory / INPUTS_FILE
    known = read_record(inputs, "record of a run's inputs") if inputs.exists() else {}
    records: dict[str, list[Mapping[str, Any]]] = {}
    try:
        for record in read_lines(directory / METRICS_FILE):
            records.setdefault(record["kind"], []).append(record)
    except (ValueError, KeyError, TypeError) as error:
        raise MechSearchError(
            f"the log at {directory / METRICS_FILE} is damaged: {error}"
        ) from None
    name, seed = str(config.get("name", directory.name)), int(config.get("seed", 0))
    return Run(name, seed, records, str(known.get("heap_set", "")))


def learning_curve(runs: Sequence[Run], metric: str, kind: str) -> LearningCurve | None:
    """Return one metric at the actions that all runs were scored at; None if there are none."""
    # A run that went on from a checkpoint may have scored a step again: the last one counts.
    series = [dict(zip(*run.series(kind, metric), strict=True)) for run in runs]
    shared = sorted(set.intersection(*map(set, series))) if series else []
    if not shared:
        return None
    return LearningCurve(np.array(shared), np.array([[s[step] for step in shared] for s in series]))


def curve_rows(condition: str, runs: Iterable[Run]) -> Iterator[tuple[str, ...]]:
    """Yield every point of the curves of a condition's runs: `CURVE_COLUMNS`, as text."""
    for run in runs:
        for kind, heaps in EVALUATIONS.items():
            for record in run.records.get(kind, ()):
                place = (condition, run.name, str(run.seed), heaps, str(record["step"]))
                for metric in dict.fromkeys((*METRICS, *GRASP_METRICS, *RETRIEVAL_METRICS)):
                    if metric in record:
                        yield (*place, metric, *_logged(record, metric))


def _logged(record: Mapping[str, Any], metric: str) -> Iterator[str]:
    """Yield mean, ends of the interval and number of heaps, empty where they were not logged."""
    for key in (metric, f"{metric}_ci_low", f"{metric}_ci_high"):
        yield f"{record[key]:.6g}" if key in record else ""
    yield str(record.get("heaps", ""))


def ordered(names: Iterable[str]) -> list[str]:
    """Return policies in the order of reports: the method, variants, teachers, ceiling, passive."""

    def rank(name: str) -> tuple[int, int, str]:
        # A name may go on with its seed, to be told from another.
        plain = name.split(",")[0]
        if plain in LISTED_FIRST:
            return 0, LISTED_FIRST.index(plain), name
        teacher, ceiling = name.startswith(TEACHER_PREFIX), name == CEILING
        return (2 if teacher else 3 if ceiling else 4 if plain in PASSIVE else 1), 0, name

    return sorted(names, key=rank)


def distinct_names(headers: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a name for each evaluation that tells it from the others, no longer than needed."""
    words = [
        (
            str(h["name"]),
            f"seed {h['training_seed'] if h['trained'] else h.get('seed', 0)}",
            f"{h['training_actions']:,} actions",
            f"file {i + 1}",
        )
        for i, h in enumerate(headers)
    ]
    names = [one[0] for one in words]
    for number in (2, 3, 4):
        longer = [", ".join(one[:number]) for one in words]
        names = [b if names.count(a) > 1 else a for a, b in zip(names, longer, strict=True)]
    return names


def _planned(folder: Path) -> Condition:
    evaluations = folder / EVALUATIONS_FOLDER
    files = episode_files([evaluations]) if evaluations.is_dir() else []
    scored = [read_scored(path) for path in files]
    for one in scored:
        if one.header["condition"] != folder.name:
            raise MechSearchError(
                f"{one.path} is of {one.header['condition']} heaps; this folder is for "
                f"{folder.name}"
            )
    runs_folder = folder / RUNS_FOLDER
    # A run that has just begun has no log yet.
    logs = sorted(runs_folder.glob(f"*/{_LOG}"))
    runs = {log.parent: read_run(log.parent) for log in logs}
    for directory, run in runs.items():
        if directory.name != f"{run.name}-seed{run.seed}":
            raise MechSearchError(
                f"{directory} holds the run {run.name}-seed{run.seed} by its {CONFIG_FILE}; "
                "expected the run that the folder is named after"
            )
    return _condition(folder.name, _longest(scored), list(runs.values()))


def _loose(sources: Sequence[Path]) -> Experiment:
    groups: dict[str, list[ScoredPolicy]] = {}
    for path in episode_files(sources):
        one = read_scored(path)
        kind = str(one.header["condition"])
        groups.setdefault(f"{kind}-retrieval" if one.retrieves else kind, []).append(one)
    if not groups:
        raise MechSearchError(
            f"no evaluation (.npz) under {', '.join(map(str, sources)) or 'nothing'}"
        )
    logs = [log for source in sources for log in sorted(source.rglob(_LOG))]
    runs: dict[str, list[Run]] = {name: [] for name in groups}
    for log in dict.fromkeys(logs):
        run = read_run(log.parent)
        places = [name for name, g in groups.items() if g[0].header["heap_set"] == run.heap_set]
        if not places and len(groups) > 1:
            raise MechSearchError(
                f"{log.parent} does not say that it learnt from the heaps of one of the conditions "
                f"{', '.join(groups)}; report it with the evaluations of its own condition alone"
            )
        # To uncover and to retrieve may be learnt from the same heaps.
        own = [name for name in places if any(one.learnt_in(run.name) for one in groups[name])]
        runs[next(iter(own or places or groups))].append(run)
    return Experiment(
        None, _by_name(_condition(name, _told_apart(g), runs[name]) for name, g in groups.items())
    )


def _condition(name: str, scored: Sequence[ScoredPolicy], runs: Sequence[Run]) -> Condition:
    for one in scored:
        for fact in ("heap_set", "split"):
            if one.header[fact] != scored[0].header[fact]:
                raise MechSearchError(
                    f"{one.path} has {fact} {one.header[fact]} and {scored[0].path.name} has "
                    f"{scored[0].header[fact]}; expected the same in one condition"
                )
        if one.retrieves != scored[0].retrieves:
            aims = ["retrieves" if o.retrieves else "uncovers" for o in (one, scored[0])]
            raise MechSearchError(
                f"{one.path} {aims[0]} and {scored[0].path.name} {aims[1]} targets; expected the "
                "same in one condition"
            )
    return Condition(name, _grouped(scored, lambda one: one.name), _grouped(runs, lambda r: r.name))


def _by_name(conditions: Iterable[Condition]) -> dict[str, Condition]:
    known = sorted(conditions, key=lambda c: (c.retrieves, not c.name.startswith("single"), c.name))
    return {condition.name: condition for condition in known}


def _longest(scored: Iterable[ScoredPolicy]) -> list[ScoredPolicy]:
    """Return for each policy and seed the scores after most training."""
    kept: dict[tuple[str, int], ScoredPolicy] = {}
    for one in scored:
        other = kept.get((one.name, one.seed))
        if other and other.actions == one.actions:
            raise MechSearchError(
                f"{other.path} and {one.path.name} are both {one.name}, seed {one.seed}, "
                f"after {one.actions:,} actions; expected one of them"
            )
        if other is None or one.actions > other.actions:
            kept[one.name, one.seed] = one
    return [kept[key] for key in sorted(kept)]


def _told_apart(scored: Iterable[ScoredPolicy]) -> list[ScoredPolicy]:
    """Return policies whose seeds share a name, unless a seed comes more than once."""
    found: list[ScoredPolicy] = []
    for seeds in _grouped(sorted(scored, key=lambda o: o.seed), lambda one: one.name).values():
        if len({one.seed for one in seeds}) < len(seeds):
            names = distinct_names([one.header for one in seeds])
            seeds = tuple(
                replace(one, header={**one.header, "name": name})
                for one, name in zip(seeds, names, strict=True)
            )
        found += seeds
    return found


def _grouped(items: Sequence[Item], name: Callable[[Item], str]) -> dict[str, tuple[Item, ...]]:
    names = ordered({name(item) for item in items})
    return {one: tuple(item for item in items if name(item) == one) for one in names}
