"""Learning curves over seeds, as the paper's Figures 4 and 5 have them, and as rows of numbers."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mechsearch.evaluation.metrics import GRASP_METRICS, Estimate, mean_interval
from mechsearch.evaluation.metrics import METRICS as ALL_METRICS
from mechsearch.report.bootstrap import mean_over_seeds_and_heaps
from mechsearch.report.curves import EVALUATIONS, Run, draw_levels
from mechsearch.report.experiment import CEILING, Condition, Experiment
from mechsearch.report.figures import GREY, PRINTED_WIDTH, colour, grid, style
from mechsearch.report.tables import display
from mechsearch.types import Floats

LEARNING = ("method", "plus", "ddpg")
ABLATION = ("method", "no-teachers", "no-asymmetry", "no-pose-input")
METRICS = ("reward", "visibility_change", "episode_actions", "graspability_change")
ABLATION_METRICS = ("reward", "visibility_change")
COLUMNS = (
    "condition",
    "variant",
    "seed",
    "scored_on",
    "step",
    "metric",
    "mean",
    "ci_low",
    "ci_high",
    "heaps",
)


@dataclass(frozen=True)
class Curve:
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


def curve(runs: Sequence[Run], metric: str, kind: str) -> Curve | None:
    """Return one metric at the actions that all runs were scored at; None if there are none."""
    series = [run.series(kind, metric) for run in runs]
    shared = set(series[0][0]) if series else set()
    for steps, _ in series:
        shared &= set(steps)
    if not shared:
        return None
    order = np.array(sorted(shared))
    rows = []
    for steps, values in series:
        # A run that went on from a checkpoint may have scored a step again.
        last = dict(zip(steps, values, strict=True))
        rows.append([last[step] for step in order])
    return Curve(order, np.array(rows))


def scored_on(experiment: Experiment) -> str:
    """Return which evaluations the curves show: on held-out heaps, wherever a run has them."""
    runs = [run for c in experiment.conditions.values() for runs in c.runs.values() for run in runs]
    return next((kind for kind in EVALUATIONS if any(run.records.get(kind) for run in runs)), "")


def draw_learning(experiment: Experiment) -> Figure:
    """Return the paper's Figure 4: metrics in rows, conditions in columns, teachers as levels."""
    return _draw(experiment, METRICS, LEARNING, 2.15)


def draw_ablation(experiment: Experiment) -> Figure:
    """Return the paper's Figure 5: the method and what is left when a part of it is taken away."""
    return _draw(experiment, ABLATION_METRICS, ABLATION, 2.5)


def curve_rows(experiment: Experiment) -> list[tuple[str, ...]]:
    """Return every point of every curve, with its interval over heaps if it has one."""
    rows: list[tuple[str, ...]] = [COLUMNS]
    for condition in experiment.conditions.values():
        for name, runs in condition.runs.items():
            for run in runs:
                for kind, heaps in EVALUATIONS.items():
                    for record in run.records.get(kind, ()):
                        place = (condition.name, name, str(run.seed), heaps, str(record["step"]))
                        rows += [(*place, metric, *cells) for metric, cells in _cells(record)]
    return rows


def _cells(record: Mapping[str, Any]) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield each metric of one evaluation with its mean, interval and number of heaps."""
    for metric in (*ALL_METRICS, *GRASP_METRICS):
        if metric in record:
            values = (record.get(metric + end, "") for end in ("", "_ci_low", "_ci_high"))
            cells = [f"{value:.6g}" if value != "" else "" for value in values]
            yield metric, (*cells, str(record.get("heaps", "")))


def _draw(
    experiment: Experiment, metrics: Sequence[str], variants: Sequence[str], height: float
) -> Figure:
    conditions, kind = list(experiment.conditions.values()), scored_on(experiment)
    with style():
        columns = len(conditions)
        figure, axes = grid(len(metrics) * columns, columns, PRINTED_WIDTH / columns, height)
        for i, ax in enumerate(axes):
            condition, metric = conditions[i % columns], metrics[i // columns]
            _panel(ax, condition, metric, variants, kind)
            if i // columns == len(metrics) - 1:
                ax.set_xlabel("training actions")
        labels: dict[str, Artist] = {}
        for ax in axes:
            handles, names = ax.get_legend_handles_labels()
            labels |= {n: h for n, h in zip(names, handles, strict=True) if n not in labels}
        if labels:
            figure.legend(list(labels.values()), list(labels), loc="outside lower center", ncols=4)
    return figure


def _panel(ax: Axes, condition: Condition, metric: str, variants: Sequence[str], kind: str) -> None:
    ax.set_title(f"{condition.name}: {display(metric).label}")
    curves = {name: curve(condition.runs.get(name, ()), metric, kind) for name in variants}
    drawn = {name: found for name, found in curves.items() if found}
    ends = {name: _end(condition, metric, name) for name in variants if name in condition.trials}
    levels = _levels(condition, metric)
    heights = [
        value for found in drawn.values() for value in (found.seeds.min(), found.seeds.max())
    ]
    heights += [mean for _, mean in ends.values() if not np.isnan(mean)]
    heights += [values[metric].mean for values in levels.values()]
    if not heights:
        ax.text(0.5, 0.5, "not measured", transform=ax.transAxes, ha="center", color=GREY)
        ax.set(xticks=[], yticks=[])
        return
    # Bands of few seeds may be far wider than what is to be seen.
    margin = 0.08 * (max(heights) - min(heights) or 1)
    limits = (min(heights) - margin, max(heights) + margin)
    scale = display(metric).scale
    for name, found in drawn.items():
        _draw_curve(ax, found, scale, limits, name)
    for name, (actions, mean) in ends.items():
        label = None if name in drawn else f"{name}, final"
        ax.plot([actions], [mean * scale], "D", color=colour(name), markersize=5, label=label)
    if not drawn and ends:
        # Final scores alone: at their place in the panels that have curves.
        ax.set_xlim(0, 1.05 * max(actions for actions, _ in ends.values()))
    ax.set_ylim(limits[0] * scale, limits[1] * scale)
    draw_levels(ax, metric, levels)


def _draw_curve(
    ax: Axes, found: Curve, scale: float, limits: tuple[float, float], name: str
) -> None:
    """Draw the mean, and where there are several seeds each of them and the band."""
    if len(found.seeds) > 1:
        low, high = (
            np.clip([getattr(mean, end) for mean in found.means], *limits) * scale
            for end in ("ci_low", "ci_high")
        )
        ax.fill_between(found.steps, low, high, color=colour(name), alpha=0.16, linewidth=0)
        for values in found.seeds * scale:
            ax.plot(found.steps, values, color=colour(name), linewidth=0.6, alpha=0.55)
    ax.plot(found.steps, found.seeds.mean(axis=0) * scale, color=colour(name), label=name)


def _end(condition: Condition, metric: str, name: str) -> tuple[float, float]:
    """Return training actions and final score on the final heaps, NaN if it was not measured."""
    actions = float(np.mean([trial.actions for trial in condition.trials[name]]))
    if not condition.measured(name, metric):
        return actions, float("nan")
    return actions, float(np.mean(condition.matrices([name], metric)[0]))


def _levels(condition: Condition, metric: str) -> Mapping[str, Mapping[str, Estimate]]:
    ceiling = [name for name in condition.trials if name == CEILING]
    names = [*condition.teachers, *condition.passive, *ceiling]
    return {
        name: {metric: mean_over_seeds_and_heaps(condition.matrices([name], metric)[0])}
        for name in names
        if condition.measured(name, metric)
    }
