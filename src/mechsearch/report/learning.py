"""Learning curves over seeds, as the paper's Figures 4 and 5 have them, and as rows of numbers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mechsearch.evaluation.metrics import Estimate, mean_interval
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
COLUMNS = ("condition", "variant", "seed", "heaps", "step", "metric", "value")


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
    """Return one metric over the steps that all the runs were scored at; None if there are none."""
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
    runs = [
        run for c in experiment.conditions.values() for runs in c.runs.values() for run in runs
    ]
    return next((kind for kind in EVALUATIONS if any(run.records.get(kind) for run in runs)), "")


def draw_learning(experiment: Experiment) -> Figure:
    """Return the paper's Figure 4: metrics in rows, conditions in columns, teachers as levels."""
    return _draw(experiment, METRICS, LEARNING, 2.15)


def draw_ablation(experiment: Experiment) -> Figure:
    """Return the paper's Figure 5: the method and what is left when a part of it is taken away."""
    return _draw(experiment, ABLATION_METRICS, ABLATION, 2.5)


def curve_rows(experiment: Experiment) -> list[tuple[str, ...]]:
    """Return every value of every curve, headings first."""
    rows: list[tuple[str, ...]] = [COLUMNS]
    for condition in experiment.conditions.values():
        for name, runs in condition.runs.items():
            for run in runs:
                for kind, heaps in EVALUATIONS.items():
                    for metric in run.keys(kind):
                        for step, value in zip(*run.series(kind, metric), strict=True):
                            cells = (str(run.seed), heaps, f"{step:.0f}", metric, f"{value:.6g}")
                            rows.append((condition.name, name, *cells))
    return rows


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
        labels: dict[str, object] = {}
        for ax in axes:
            handles, names = ax.get_legend_handles_labels()
            labels |= {n: h for n, h in zip(names, handles, strict=True) if n not in labels}
        if labels:
            figure.legend(
                list(labels.values()), list(labels), loc="outside lower center", ncols=4
            )
    return figure


def _panel(
    ax: Axes, condition: Condition, metric: str, variants: Sequence[str], kind: str
) -> None:
    ax.set_title(f"{condition.name}: {display(metric).label}")
    heights = [
        height
        for name in variants
        for height in (
            _draw_curve(ax, condition.runs.get(name, ()), metric, kind, name),
            _draw_end(ax, condition, metric, name),
        )
        if height
    ]
    levels = _levels(condition, metric)
    if not heights and not levels:
        ax.text(0.5, 0.5, "not measured", transform=ax.transAxes, ha="center", color=GREY)
        ax.set(xticks=[], yticks=[])
        return
    # Bands of few seeds may be far wider than what is to be seen.
    scale = display(metric).scale
    ends = [end for pair in heights for end in pair]
    ends += [values[metric].mean * scale for values in levels.values()]
    margin = 0.08 * (max(ends) - min(ends) or 1)
    ax.set_ylim(min(ends) - margin, max(ends) + margin)
    draw_levels(ax, metric, levels)


def _draw_curve(
    ax: Axes, runs: Sequence[Run], metric: str, kind: str, name: str
) -> tuple[float, float] | None:
    """Draw mean, band and each seed; return the lowest and highest value of a seed."""
    found = curve(runs, metric, kind)
    if found is None or not _counts_actions(runs):
        return None
    seeds = found.seeds * display(metric).scale
    if len(seeds) > 1:
        scale = display(metric).scale
        low, high = (
            [getattr(mean, end) * scale for mean in found.means] for end in ("ci_low", "ci_high")
        )
        ax.fill_between(found.steps, low, high, color=colour(name), alpha=0.16, linewidth=0)
        for values in seeds:
            ax.plot(found.steps, values, color=colour(name), linewidth=0.6, alpha=0.55)
    ax.plot(found.steps, seeds.mean(axis=0), color=colour(name), label=name)
    return float(seeds.min()), float(seeds.max())


def _draw_end(
    ax: Axes, condition: Condition, metric: str, name: str
) -> tuple[float, float] | None:
    """Draw the final score on the final heaps; return its height twice."""
    if not condition.measured(name, metric):
        return None
    trials = condition.trials[name]
    mean = float(np.mean(condition.matrices([name], metric)[0])) * display(metric).scale
    actions = float(np.mean([trial.actions for trial in trials]))
    label = f"{name}, final" if name not in condition.runs else None
    ax.plot([actions], [mean], "D", color=colour(name), markersize=5, label=label, clip_on=False)
    return mean, mean


def _counts_actions(runs: Sequence[Run]) -> bool:
    """Return whether a run's steps are actions: those of imitation are updates."""
    return not any(run.records.get("imitation") for run in runs)


def _levels(condition: Condition, metric: str) -> Mapping[str, Mapping[str, Estimate]]:
    names = [*condition.teachers, *condition.passive, *([CEILING] if CEILING in condition.trials else [])]
    return {
        name: {metric: mean_over_seeds_and_heaps(condition.matrices([name], metric)[0])}
        for name in names
        if condition.measured(name, metric)
    }
