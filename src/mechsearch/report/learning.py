"""Learning curves over seeds, as the paper's Figures 4 and 5 have them, and what went on inside."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mechsearch.findings.claims import PAPER_METRICS
from mechsearch.findings.experiment import Condition, Experiment
from mechsearch.findings.runs import LearningCurve, Run, learning_curve
from mechsearch.findings.tables import display
from mechsearch.report.figures import COLOURS, GREY, PRINTED_WIDTH, panels, policy_marks, style
from mechsearch.types import Floats

LEARNING = ("method", "plus", "ddpg")
ABLATION = ("method", "no-teachers", "no-asymmetry", "no-pose-input")
ABLATION_METRICS = ("reward", "visibility_change")
RUN_METRICS = ("reward", "visibility_change", "uncovered_rate", "clutter_moved_m")
_WINDOW = 15


def draw_learning(experiment: Experiment) -> Figure:
    """Return the paper's Figure 4: metrics in rows, conditions in columns, teachers as levels."""
    return draw_curves(experiment, PAPER_METRICS, LEARNING, 2.15)


def draw_ablation(experiment: Experiment) -> Figure:
    """Return the paper's Figure 5: the method and what is left when a part of it is taken away."""
    return draw_curves(experiment, ABLATION_METRICS, ABLATION, 2.5)


def draw_curves(
    experiment: Experiment, metrics: Sequence[str], variants: Sequence[str], height: float
) -> Figure:
    """Return the curves of some variants: metrics in rows, conditions in columns.

    Args:
        experiment: With the runs.
        metrics: One row each, or two in a row where there is one condition.
        variants: Names of the runs.
        height: Of a row [inch].
    """
    conditions, kind = list(experiment.conditions.values()), experiment.scored_on
    places = [(metric, condition) for metric in metrics for condition in conditions]
    columns = max(2, len(conditions))
    with style():
        figure, axes = panels(len(places), columns, PRINTED_WIDTH / columns, height)
        labels: dict[str, Artist] = {}
        for i, (ax, (metric, condition)) in enumerate(zip(axes, places, strict=True)):
            _panel(ax, condition, metric, variants, kind)
            if i + columns >= len(places):
                ax.set_xlabel("training actions")
            handles, names = ax.get_legend_handles_labels()
            labels |= {n: h for n, h in zip(names, handles, strict=True) if n not in labels}
        if labels:
            figure.legend(list(labels.values()), list(labels), loc="outside lower center", ncols=4)
    return figure


def draw_training(run: Run) -> Figure | None:
    """Return what went on in training, or None if nothing was logged.

    Reinforcement: each episode's return, the critic's first Q against the return that followed,
    the share of saturated actions, and who chose the actions. Pushes: each episode's return and its
    number of pushes, and what each fit learnt from and found. Of episodes, running means.
    """
    if not run.records.get("episode"):
        return None
    diagrams = _PUSHES if "pushes" in run.keys("episode") else _reinforcement(run)
    with style():
        figure, axes = panels(len(diagrams), 2, 4.8, 2.6)
        for ax, diagram in zip(axes, diagrams, strict=True):
            _draw_diagram(ax, run, diagram)
    return figure


@dataclass(frozen=True)
class _Diagram:
    """Some numbers of one kind of record, beside each other."""

    title: str
    kind: str
    keys: Sequence[str]
    over: str = "step"
    shares: bool = False


_PUSHES = (
    _Diagram("return of each episode", "episode", ["return"], "executed"),
    _Diagram("pushes in each episode", "episode", ["pushes"], "executed"),
    _Diagram("loss of each fit", "fit", ["loss"]),
    _Diagram("rewards to come: at once, less for occlusion", "fit", ["at_once", "by_occlusion"]),
    _Diagram("pushes learnt from", "fit", ["pushes"]),
    _Diagram("actions", "fit", ["executed", "simulated"]),
)


def _reinforcement(run: Run) -> Sequence[_Diagram]:
    choices = [key for key in run.keys("episode") if key.startswith("chosen_")]
    expected = "Q at the start, and the return that followed"
    return (
        _Diagram("return of each episode", "episode", ["return"]),
        _Diagram(expected, "episode", ["q_start", "return_start"]),
        _Diagram("share of saturated actions", "episode", ["saturated"], shares=True),
        _Diagram("who chose the actions", "episode", choices, shares=True),
    )


def _draw_diagram(ax: Axes, run: Run, diagram: _Diagram) -> None:
    window = _WINDOW if diagram.kind == "episode" else 1
    for key, colour in zip(diagram.keys, COLOURS, strict=False):
        steps, values = run.series(diagram.kind, key, diagram.over)
        if len(steps):
            label = key.removeprefix("chosen_").replace("_", " ")
            ax.plot(steps, running_mean(values, window), color=colour, label=label)
    ax.set_title(diagram.title)
    ax.set_xlabel("training action")
    if diagram.shares:
        ax.set_ylim(-0.02, 1.02)
    if len(diagram.keys) > 1 and ax.lines:
        ax.legend(loc="best", fontsize=8)


def running_mean(values: Floats, window: int) -> Floats:
    """Return the mean of each value and those before it, at most `window` in all (n,)."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    ends = np.arange(1, len(values) + 1)
    starts = np.maximum(ends - window, 0)
    mean: Floats = (sums[ends] - sums[starts]) / (ends - starts)
    return mean


def _panel(ax: Axes, condition: Condition, metric: str, variants: Sequence[str], kind: str) -> None:
    ax.set_title(f"{condition.name}: {display(metric).label}")
    curves = {n: learning_curve(condition.runs.get(n, ()), metric, kind) for n in variants}
    drawn = {name: found for name, found in curves.items() if found}
    means = {
        name: float(condition.matrices([name], metric)[0].mean())
        for name in condition.policies
        if condition.measured(metric, name)
    }
    ends = {name: means.get(name, np.nan) for name in variants if name in condition.policies}
    levels = {name: mean for name, mean in means.items() if name not in condition.learnt}
    heights = [end for found in drawn.values() for end in (found.seeds.min(), found.seeds.max())]
    heights += [mean for mean in ends.values() if not np.isnan(mean)]
    heights += levels.values()
    if not heights:
        ax.text(0.5, 0.5, "not measured", transform=ax.transAxes, ha="center", color=GREY)
        ax.set(xticks=[], yticks=[])
        return
    # Bands of few seeds may be far wider than what is to be seen.
    margin = 0.08 * (max(heights) - min(heights) or 1)
    limits = (min(heights) - margin, max(heights) + margin)
    scale, marks = display(metric).scale, policy_marks(variants)
    for name, found in drawn.items():
        _draw_curve(ax, found, scale, limits, name, marks[name][0])
    actions = {n: float(np.mean([one.actions for one in condition.policies[n]])) for n in ends}
    for name, mean in ends.items():
        label = None if name in drawn else f"{name}, final"
        colour = marks[name][0]
        ax.plot([actions[name]], [mean * scale], "D", color=colour, markersize=5, label=label)
    if not drawn and ends:
        # Final scores alone: at their place in the panels that have curves.
        ax.set_xlim(0, 1.05 * max(actions.values()))
    ax.set_ylim(limits[0] * scale, limits[1] * scale)
    _draw_levels(ax, {name: level * scale for name, level in levels.items()})


def _draw_curve(
    ax: Axes,
    found: LearningCurve,
    scale: float,
    limits: tuple[float, float],
    name: str,
    colour: str,
) -> None:
    """Draw the mean, and where there are several seeds each of them and the band."""
    if len(found.seeds) > 1:
        low, high = (
            np.clip([getattr(mean, end) for mean in found.means], *limits) * scale
            for end in ("ci_low", "ci_high")
        )
        ax.fill_between(found.steps, low, high, color=colour, alpha=0.16, linewidth=0)
        for values in found.seeds * scale:
            ax.plot(found.steps, values, color=colour, linewidth=0.6, alpha=0.55)
    ax.plot(found.steps, found.seeds.mean(axis=0) * scale, color=colour, label=name)


def _draw_levels(ax: Axes, levels: Mapping[str, float]) -> None:
    """Draw scores of policies that do not learn as grey levels, named at the right."""
    for level in levels.values():
        ax.axhline(level, color=GREY, linewidth=1, zorder=0)
    low, high = ax.get_ylim()
    ordered = sorted(levels, key=lambda name: levels[name])
    heights = spaced([(levels[name] - low) / (high - low) for name in ordered], 0.075)
    for name, height in zip(ordered, heights, strict=True):
        text = ax.text(1.015, height, name, transform=ax.transAxes, va="center")
        text.set(fontsize=7.5, color=GREY)
    ax.set_ylim(low, high)


def spaced(heights: Sequence[float], gap: float) -> list[float]:
    """Return ascending heights moved as little as needed to lie at least `gap` apart."""
    groups: list[list[float]] = []
    for height in heights:
        groups.append([height])
        # Labels that touch share the middle of where they want to be.
        while len(groups) > 1 and _places(groups[-1], gap)[0] - _places(groups[-2], gap)[-1] < gap:
            last = groups.pop()
            groups[-1] += last
    return [place for group in groups for place in _places(group, gap)]


def _places(group: Sequence[float], gap: float) -> list[float]:
    bottom = sum(group) / len(group) - gap * (len(group) - 1) / 2
    return [bottom + i * gap for i in range(len(group))]
