"""Figures in one style: scores, what actions cost, and learning curves over seeds.

As SVG text they are the same bytes from the same numbers. Learning curves are drawn as the paper's
Figures 4 and 5 have them.
"""

import io
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from itertools import cycle
from typing import Any, NamedTuple

import matplotlib.style
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

from mechsearch.evaluation.episodes import (
    HIGHER_IS_BETTER,
    METRICS,
    RETRIEVAL_METRICS,
    Estimate,
    SummaryRow,
)
from mechsearch.findings.experiment import (
    VALIDATION,
    Condition,
    Experiment,
    LearningCurve,
    Run,
    learning_curve,
)
from mechsearch.findings.tables import PAPER_METRICS, Scores, display
from mechsearch.pictures.canvas import legible
from mechsearch.types import Floats, MechSearchError

# Okabe and Ito's colours, told apart by colour-blind readers; yellow is left out on white paper.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
GREY = "#8a8f98"
PRINTED_WIDTH = 7.4
"""Of a figure that fills an A4 page between its margins [inch]."""

_POLICIES = {
    "method": (COLOURS[0], "o"),
    "plus": (COLOURS[3], "D"),
    "ddpg": (COLOURS[1], "v"),
    "no-teachers": (COLOURS[2], "s"),
    "no-asymmetry": (COLOURS[4], "^"),
    "no-pose-input": (COLOURS[5], "P"),
    "as-printed": (COLOURS[2], "X"),
    "teacher-straight": ("#3f444d", ">"),
    "teacher-zigzag": ("#6b717c", "h"),
    "teacher-spiral": ("#3f444d", "<"),
    "look-ahead": (COLOURS[6], "*"),
    "random": (GREY, "x"),
    "idle": (GREY, "+"),
}
_STYLE: dict[str, Any] = {
    "svg.hashsalt": "mechsearch",
    "font.size": 9.5,
    "font.family": "DejaVu Sans",
    "text.parse_math": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#5b616b",
    "axes.labelcolor": "#20242c",
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "xtick.color": "#5b616b",
    "ytick.color": "#5b616b",
    "legend.frameon": False,
    "lines.linewidth": 1.8,
}
_style = partial(matplotlib.style.context, _STYLE)
_RULES: dict[str, Any] = {"color": "#e3e5e8", "linewidth": 0.8}

LEARNING = ("method", "plus", "ddpg", "as-printed")
ABLATION = ("method", "no-teachers", "no-asymmetry", "no-pose-input")
ABLATION_METRICS = ("reward", "visibility_change")
RUN_METRICS = ("reward", "visibility_change", "uncovered_rate", "clutter_moved_m")
RETRIEVAL_RUN_METRICS = ("reward", "retrieved_within_1", "retrieved_within_5", "push_actions")
ACTIONS = "training actions"
"""What all curves of runs are drawn over: actions executed to learn from."""
_WINDOW = 15


def policy_marks(names: Iterable[str]) -> dict[str, tuple[str, str]]:
    """Return colour and mark of policies: those of the paper have their own in all figures."""
    listed = list(names)
    taken = {_POLICIES[name][0] for name in listed if name in _POLICIES}
    free = cycle([colour for colour in COLOURS if colour not in taken] or COLOURS)
    return {name: _POLICIES.get(name) or (next(free), ".") for name in listed}


def panels(number: int, columns: int, width: float, height: float) -> tuple[Figure, list[Axes]]:
    """Return a figure with `number` axes in rows of `columns`, each `width` x `height` [inch]."""
    rows = -(-number // columns)
    figure = Figure(figsize=(width * columns, height * rows), layout="constrained")
    axes = [figure.add_subplot(rows, columns, i + 1) for i in range(number)]
    return figure, axes


def to_svg(figure: Figure) -> str:
    """Return a figure as SVG text without a date."""
    buffer = io.StringIO()
    for text in figure.findobj(Text):
        assert isinstance(text, Text)
        text.set_text(legible(text.get_text()))
    with _style():
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def draw_scores(scores: Mapping[str, Sequence[Scores]], highlight: Sequence[str] = ()) -> Figure:
    """Return dots with their intervals: policies in rows, and a panel for each metric.

    Args:
        scores: Each policy's scores, one for every seed or one for all.
        highlight: Policies drawn in colour; the others are grey.
    """
    with _style():
        height = 0.9 + 0.22 * sum(max(1, len(seeds)) for seeds in scores.values())
        shown = _shown_metrics(scores)
        figure, axes = panels(len(shown), 3, 3.4, height)
        for i, (metric, ax) in enumerate(zip(shown, axes, strict=True)):
            _scores_panel(ax, metric, scores, highlight)
            if i % 3:
                ax.set_yticklabels([])
    return figure


def draw_summary(rows: Sequence[SummaryRow]) -> Figure:
    """Return a summary's rows as dots, one for every seed; what learnt is in colour.

    Raises:
        MechSearchError: If there is no row.
    """
    if not rows:
        raise MechSearchError("the summary has no rows to draw; expected at least one")
    ordered = sorted(rows, key=_rank)
    scores: dict[str, dict[int, dict[str, Estimate]]] = {}
    for row in ordered:
        seeds = scores.setdefault(_label(row, rows), {})
        estimate = Estimate(row.mean, row.ci_low, row.ci_high, 0)
        seeds.setdefault(row.seed, {})[row.metric] = estimate
    trained = dict.fromkeys(_label(row, rows) for row in ordered if row.actions)
    return draw_scores({name: list(s.values()) for name, s in scores.items()}, list(trained))


def draw_tradeoff(condition: Condition) -> Figure:
    """Return the condition's two scores against each other, on the same axes everywhere.

    One panel has all heaps; one follows for each number of objects.
    """
    tradeoff = condition.tradeoff
    counts: list[int | None] = [None, *(condition.counts if len(condition.counts) > 1 else [])]
    measured = [
        {name: condition.scores_of(name, tradeoff, count) for name in condition.policies}
        for count in counts
    ]
    found = [{name: scores for name, scores in panel.items() if scores} for panel in measured]
    limits = _limits([scores for panel in found for scores in panel.values()], tradeoff)
    columns = min(len(counts), 4)
    with _style():
        figure, axes = panels(len(counts), columns, PRINTED_WIDTH / columns, 2.4)
        for ax, count, panel in zip(axes, counts, found, strict=True):
            _tradeoff_panel(ax, panel, limits)
            whole = "all heaps" if condition.retrieves else f"{condition.name}, all heaps"
            ax.set_title(f"{count} objects" if count else whole)
        for ax in axes[::columns]:
            ax.set_ylabel(display(tradeoff[1]).label)
        across = display(tradeoff[0]).label if condition.retrieves else "actions used"
        _label_below(figure, axes, columns, across, ncols=5, fontsize=8)
    return figure


def draw_reliability(curves: Mapping[str, Floats]) -> Figure:
    """Return predicted chances of success against what happened, and how often each was predicted.

    Args:
        curves: By name: mean prediction, share of successes and number (b, 3) of each bin.
    """
    with _style():
        figure, (ax, below) = panels(2, 1, 4.6, 2.9)
        ax.plot([0, 1], [0, 1], color=GREY, linewidth=1, linestyle="--", zorder=0)
        for i, ((name, curve), colour) in enumerate(zip(curves.items(), COLOURS, strict=False)):
            predicted, share, number = curve.T
            ax.plot(predicted, share, "o-", color=colour, label=name, markersize=4)
            width = 0.08 / len(curves)
            places = (predicted * 10).astype(int).clip(0, 9) / 10 + 0.01 + (i + 0.5) * width
            below.bar(places, number / number.sum(), width, color=colour)
        ax.set(xlim=(0, 1), ylim=(0, 1), ylabel="share that succeeds")
        ax.legend(loc="upper left")
        below.set(xlim=(0, 1), xlabel="predicted chance of success", ylabel="share of all")
    return figure


def _rank(row: SummaryRow) -> tuple[str, str, bool, bool, str, int]:
    teacher = row.variant.startswith("teacher-")
    return row.experiment, row.condition, not row.actions, not teacher, row.variant, row.actions


def _label(row: SummaryRow, rows: Sequence[SummaryRow]) -> str:
    """Return a row's variant, with as much as it takes to tell it from the others."""
    words = [
        text
        for text, several in (
            (row.experiment, len({r.experiment for r in rows}) > 1),
            (row.condition, len({r.condition for r in rows}) > 1),
            (row.variant, True),
            (f"{row.actions:,}", len({r.actions for r in rows if r.variant == row.variant}) > 1),
        )
        if several
    ]
    return ", ".join(words)


def _shown_metrics(scores: Mapping[str, Sequence[Scores]]) -> list[str]:
    """Return what there is to draw: scores of uncovering, of retrieval, or both."""
    measured = {metric for seeds in scores.values() for values in seeds for metric in values}
    retrieving = measured.intersection(RETRIEVAL_METRICS).difference(METRICS)
    uncovering = measured.intersection(METRICS).difference(RETRIEVAL_METRICS, ("reward",))
    names = METRICS if uncovering or not retrieving else ()
    return list(dict.fromkeys((*names, *(RETRIEVAL_METRICS if retrieving else ()))))


def _scores_panel(
    ax: Axes, metric: str, scores: Mapping[str, Sequence[Scores]], highlight: Sequence[str]
) -> None:
    scale, row, ticks = display(metric).scale, 0.0, []
    marks = policy_marks(highlight)
    for name, seeds in scores.items():
        colour = marks[name][0] if name in marks else GREY
        ticks.append(row + (len(seeds) - 1) / 2)
        for values in seeds:
            if metric in values:
                x, low, high = _scaled(values[metric], scale)
                # An interval that does not exist is NaN, and not drawn.
                ax.plot([low, high], [row, row], color=colour, linewidth=2.4)
                ax.plot([x], [row], "o", color=colour, markersize=5.5)
            row += 1
        row += 0.5
    arrow = "more is better →" if HIGHER_IS_BETTER[metric] else "← less is better"
    ax.set_title(display(metric).label)
    ax.set_xlabel(arrow, fontsize=8, color=GREY)
    ax.set_yticks(ticks, [legible(name) for name in scores])
    ax.tick_params(axis="y", length=0)
    ax.spines["left"].set_visible(False)
    ax.grid(axis="x", **_RULES)
    ax.set_axisbelow(True)
    ax.invert_yaxis()


def _limits(found: Sequence[Scores], metrics: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Return the ends of both axes: by the means, since intervals of few seeds may be far wider."""
    limits = {}
    for metric in metrics:
        means = [one[metric].mean * display(metric).scale for one in found]
        margin = 0.12 * (max(means) - min(means) or 1)
        limits[metric] = (min(means) - margin, max(means) + 2 * margin)
    return limits


def _tradeoff_panel(
    ax: Axes, found: Mapping[str, Scores], limits: Mapping[str, tuple[float, float]]
) -> None:
    across, up = limits.values()
    for name, (colour, mark) in policy_marks(found).items():
        (x, *ends), (y, *heights) = (
            _scaled(found[name][metric], display(metric).scale) for metric in limits
        )
        ax.plot(np.clip(ends, *across), [y, y], color=colour, linewidth=1, alpha=0.6)
        ax.plot([x, x], np.clip(heights, *up), color=colour, linewidth=1, alpha=0.6)
        ax.plot([x], [y], mark, color=colour, markersize=5.5, label=name)
    ax.set(xlim=across, ylim=up)
    ax.grid(**_RULES)
    ax.set_axisbelow(True)


def _scaled(estimate: Estimate, scale: float) -> tuple[float, float, float]:
    return estimate.mean * scale, estimate.ci_low * scale, estimate.ci_high * scale


def _label_below(
    figure: Figure, axes: Sequence[Axes], columns: int, axis: str, **looks: int
) -> None:
    """Name the axis below the lowest panels, and below them what they show, each thing once."""
    for ax in axes[-columns:]:
        ax.set_xlabel(axis)
    labels: dict[str, Artist] = {}
    for ax in axes:
        for handle, name in zip(*ax.get_legend_handles_labels(), strict=True):
            labels.setdefault(name, handle)
    if labels:
        figure.legend(labels.values(), labels.keys(), loc="outside lower center", **looks)


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

    Final scores, and levels of policies that do not learn, are drawn unless the curves are on
    validation heaps: theirs are others.

    Args:
        experiment: With the runs.
        metrics: One row each, or two in a row where there is one condition; of runs that retrieve
            `RETRIEVAL_RUN_METRICS` in their place.
        variants: Names of the runs.
        height: Of a row [inch].
    """
    conditions = [c for c in experiment.conditions.values() if c.runs or not c.retrieves]
    kind = experiment.scored_on
    places = [
        (RETRIEVAL_RUN_METRICS[row] if condition.retrieves else metric, condition)
        for row, metric in enumerate(metrics)
        for condition in conditions
    ]
    columns = max(2, len(conditions))
    with _style():
        figure, axes = panels(len(places), columns, PRINTED_WIDTH / columns, height)
        for ax, (metric, condition) in zip(axes, places, strict=True):
            _curves_panel(ax, condition, metric, variants, kind)
        scored = [one for condition in conditions for one in condition.scored]
        if scored and kind != VALIDATION:
            heaps = _either(len(one.heaps) for one in scored)
            axes[0].plot([], [], "D", color=GREY, markersize=5, label=f"final score, {heaps}")
            axes[0].plot([], [], color=GREY, linewidth=1, label=f"does not learn, {heaps}")
        records = [record for run in experiment.runs for record in run.records.get(kind, ())]
        curves = _either(int(record["heaps"]) for record in records if "heaps" in record)
        below = f"{ACTIONS}; curves on {curves}" if records else ACTIONS
        _label_below(figure, axes, columns, below, ncols=3)
    return figure


def _either(counts: Iterable[int]) -> str:
    """Return numbers of heaps in words, such as "300 heaps"."""
    return f"{' or '.join(map(str, sorted(set(counts))))} heaps".lstrip()


def draw_training(run: Run) -> Figure | None:
    """Return what went on in training, or None if nothing was logged.

    Reinforcement: each episode's return, the critic's first Q against the return that followed,
    the share of saturated actions, and who chose the actions. Pushes: each episode's return and its
    number of pushes, and what each fit learnt from and found. Of episodes, running means.
    """
    if not run.records.get("episode"):
        return None
    told = _PUSHES if "pushes" in run.keys("episode") else _reinforcement(run)
    diagrams = [one for one in told if {*one.keys} & {*run.keys(one.kind)}]
    with _style():
        figure, axes = panels(len(diagrams), 2, 4.8, 2.6)
        for ax, diagram in zip(axes, diagrams, strict=True):
            _draw_diagram(ax, run, diagram)
    return figure


class _Diagram(NamedTuple):
    """Some numbers of one kind of record, beside each other."""

    title: str
    kind: str
    keys: Sequence[str]
    over: str = "executed"
    shares: bool = False


_PUSHES = (
    _Diagram("return of each episode", "episode", ["return"]),
    _Diagram("pushes in each episode", "episode", ["pushes"]),
    _Diagram("loss of each fit", "fit", ["loss"]),
    _Diagram("rewards to come: at once, less for occlusion", "fit", ["at_once", "by_occlusion"]),
    _Diagram("pushes learnt from", "fit", ["pushes"]),
    _Diagram("actions", "fit", ["executed", "simulated"]),
)


def _reinforcement(run: Run) -> Sequence[_Diagram]:
    choices = [key for key in run.keys("episode") if key.startswith("chosen_")]
    expected = "Q at the start, and the return that followed"
    return (
        _Diagram("return of each episode", "episode", ["return"], "step"),
        _Diagram("actions of each episode", "episode", ["length"], "step"),
        _Diagram(expected, "episode", ["q_start", "return_start"], "step"),
        _Diagram("share of saturated actions", "episode", ["saturated"], "step", shares=True),
        _Diagram("who chose the actions", "episode", choices, "step", shares=True),
    )


def _draw_diagram(ax: Axes, run: Run, diagram: _Diagram) -> None:
    window = _WINDOW if diagram.kind == "episode" else 1
    for key, colour in zip(diagram.keys, COLOURS, strict=False):
        steps, values = run.series(diagram.kind, key, diagram.over)
        if len(steps):
            label = key.removeprefix("chosen_").replace("_", " ")
            ax.plot(steps, running_mean(values, window), color=colour, label=label)
    ax.set_title(diagram.title)
    ax.set_xlabel(ACTIONS)
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


def _curves_panel(
    ax: Axes, condition: Condition, metric: str, variants: Sequence[str], kind: str
) -> None:
    ax.set_title(f"{condition.name}: {display(metric).label}")
    curves = ((n, learning_curve(condition.runs.get(n, ()), metric, kind)) for n in variants)
    drawn = {name: found for name, found in curves if found}
    means = {
        name: float(condition.matrices([name], metric)[0].mean())
        for name in condition.policies
        if kind != VALIDATION and condition.measured(metric, name)
    }
    ends = {name: means[name] for name in variants if name in means}
    levels = {name: mean for name, mean in means.items() if name not in condition.learnt}
    heights = [end for found in drawn.values() for end in (found.seeds.min(), found.seeds.max())]
    heights += [mean for name, mean in means.items() if name in ends or name in levels]
    if not heights:
        ax.text(0.5, 0.5, "not measured", transform=ax.transAxes, ha="center", color=GREY)
        ax.set(xticks=[], yticks=[])
        return
    # Bands of few seeds may be far wider than what is to be seen.
    margin = 0.08 * (max(heights) - min(heights) or 1)
    limits = np.array([min(heights) - margin, max(heights) + margin])
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
    ax.set_ylim(*limits * scale)
    _draw_levels(ax, {name: level * scale for name, level in levels.items()})


def _draw_curve(
    ax: Axes, found: LearningCurve, scale: float, limits: Floats, name: str, colour: str
) -> None:
    """Draw the mean, and where there are several seeds each of them and the band within limits."""
    if len(found.seeds) > 1:
        low = np.clip([mean.ci_low for mean in found.means], *limits) * scale
        high = np.clip([mean.ci_high for mean in found.means], *limits) * scale
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
