"""Tables of an experiment: scores over seeds and heaps, and how each policy came about."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from mechsearch.evaluation.metrics import (
    GRASP_METRICS,
    METRICS,
    SHARES,
    Estimate,
    share_interval,
)
from mechsearch.report.bootstrap import mean_over_seeds_and_heaps
from mechsearch.report.document import Grid
from mechsearch.report.experiment import Condition, Experiment, Trial
from mechsearch.report.tables import Table, cell, display

NOTE = (
    "Means with 95 % intervals over training seeds and heaps (heaps alone where there is one seed)."
    " Every episode counts, lost targets and failed simulations included; an unfinished one counts "
    "all its actions. Clutter moved is the path length of a non-target object."
)

_MADE = ("policy", "seeds", "trained for", "tried besides", "heaps", "left out", "observes")
_MADE_WIDTHS = (20, 13, 14, 15, 9, 11, 40)


def score_grid(condition: Condition) -> Grid:
    """Return policies in rows and every metric that one of them has in columns."""
    metrics = [
        metric
        for metric in (*METRICS, *GRASP_METRICS)
        if any(condition.measured(name, metric) for name in condition.trials)
    ]
    columns = ("policy", "seeds", "heaps", *(display(metric).label for metric in metrics))
    rows = []
    for name, trials in condition.trials.items():
        cells = []
        for metric in metrics:
            found = condition.measured(name, metric)
            cells.append(cell(metric, estimate(condition, name, metric)) if found else "")
        heaps = condition.matrices([name], METRICS[0])[0].shape[1]
        rows.append((name, str(len(trials)), str(heaps), *cells))
    return Grid(Table(f"Scores in {condition.name} heaps", columns, tuple(rows)))


def count_grid(condition: Condition, metric: str) -> Grid:
    """Return policies in rows and one metric by number of objects in columns."""
    counts = condition.counts
    rows = []
    for name, trials in condition.trials.items():
        cells = []
        for count in counts:
            present = all((trial.counts == count).any() for trial in trials)
            cells.append(cell(metric, estimate(condition, name, metric, count)) if present else "")
        rows.append((name, *cells))
    columns = ("policy", *(f"{count} objects" for count in counts))
    caption = f"{display(metric).label} in {condition.name} heaps, by number of objects"
    return Grid(Table(caption, columns, tuple(rows)))


def estimate(condition: Condition, name: str, metric: str, count: int | None = None) -> Estimate:
    """Return a policy's mean over seeds and heaps."""
    values = condition.matrices([name], metric, count)[0]
    # Outcomes that are all alike leave a bootstrap nothing to draw from.
    if set(values.ravel().tolist()) in ({0.0}, {1.0}) and metric in SHARES:
        return share_interval(values.mean(axis=0))
    found = mean_over_seeds_and_heaps(values)
    if metric not in SHARES:
        return found
    # Of few seeds an interval may end beyond what a share can be.
    return replace(found, ci_low=max(0.0, found.ci_low), ci_high=min(1.0, found.ci_high))


def made_grid(condition: Condition) -> Grid:
    """Return how each scored policy came about."""
    rows = []
    for name, trials in condition.trials.items():
        headers = [trial.header for trial in trials]
        learnt = [trial.actions for trial in trials if trial.trained]
        rows.append(
            (
                name,
                ", ".join(str(trial.seed) for trial in trials),
                _range(learnt),
                _range([_tried(condition, trial) for trial in trials]),
                _range([len(trial.heaps) for trial in trials]),
                _range([len(header.get("quarantined", ())) for header in headers]),
                ", ".join(map(str, headers[0].get("keys", ()))),
            )
        )
    first = next(iter(condition.trials.values()))[0].header
    facts = {
        "heap set": first.get("heap_set"),
        "objects": Path(str(first.get("object_set", ""))).name,
        "mechsearch": first.get("version"),
        "MuJoCo": first.get("engine"),
    }
    said = "; ".join(f"{key} {value}" for key, value in facts.items() if value)
    caption = f"{condition.name.capitalize()} heaps: {said}"
    return Grid(Table(caption, _MADE, tuple(rows)), words=True, widths=_MADE_WIDTHS)


def _tried(condition: Condition, trial: Trial) -> int:
    """Return how many actions were simulated to learn, and to plan while it was scored."""
    learnt = 0
    if trial.trained:
        runs = [run for run in condition.runs.get(trial.name, ()) if run.seed == trial.seed]
        fits = [record for run in runs for record in run.records.get("fit", ())]
        learnt = max((int(record["simulated"]) for record in fits), default=0)
    return learnt + int(trial.header.get("simulated_actions", 0))


def plan_text(experiment: Experiment) -> str:
    """Return the plan that the experiments follow, in a line."""
    parts = [f"{key.replace('_', ' ')} {_text(value)}" for key, value in experiment.plan.items()]
    return f"The plan of the experiments: {'; '.join(sorted(parts))}."


def _text(value: object) -> str:
    """Return a value of the plan; of paths the last part, since machines differ in the others."""
    if isinstance(value, list):
        return ", ".join(map(str, value))
    if isinstance(value, dict):
        return ", ".join(f"{key} {_text(one)}" for key, one in value.items())
    return Path(value).name if isinstance(value, str) else str(value)


def _range(numbers: Sequence[int]) -> str:
    """Return a number, or the least and the greatest; "none" for nothing."""
    if not numbers or not max(numbers):
        return "none"
    least, most = min(numbers), max(numbers)
    return f"{most:,}" if least == most else f"{least:,} to {most:,}"
