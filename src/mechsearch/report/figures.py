"""Figures of scores, in one style; as SVG text, the same bytes from the same numbers."""

import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mechsearch.evaluation.episodes import HIGHER_IS_BETTER, METRICS, Estimate, SummaryRow
from mechsearch.findings.analysis import TRADEOFF
from mechsearch.findings.experiment import Condition
from mechsearch.findings.tables import Scores, display
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
_RULES: dict[str, Any] = {"color": "#e3e5e8", "linewidth": 0.8}


def policy_marks(names: Iterable[str]) -> dict[str, tuple[str, str]]:
    """Return colour and mark of policies: those of the paper have their own in all figures."""
    listed = list(names)
    free = [c for c in COLOURS if c not in {_POLICIES[n][0] for n in listed if n in _POLICIES}]
    others = [name for name in listed if name not in _POLICIES]
    marks = {
        name: ((free or COLOURS)[i % len(free or COLOURS)], ".") for i, name in enumerate(others)
    }
    return {name: _POLICIES.get(name) or marks[name] for name in listed}


@contextmanager
def style() -> Iterator[None]:
    """Draw in the project's style within the block."""
    with matplotlib.style.context(_STYLE):
        yield


def panels(number: int, columns: int, width: float, height: float) -> tuple[Figure, list[Axes]]:
    """Return a figure with `number` axes in rows of `columns`, each `width` x `height` [inch]."""
    rows = -(-number // columns)
    figure = Figure(figsize=(width * columns, height * rows), layout="constrained")
    axes = [figure.add_subplot(rows, columns, i + 1) for i in range(number)]
    return figure, axes


def to_svg(figure: Figure) -> str:
    """Return a figure as SVG text without a date."""
    buffer = io.StringIO()
    with style():
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def draw_scores(scores: Mapping[str, Sequence[Scores]], highlight: Sequence[str] = ()) -> Figure:
    """Return dots with their intervals: policies in rows, and a panel for each metric.

    Args:
        scores: Each policy's scores, one for every seed or one for all.
        highlight: Policies drawn in colour; the others are grey.
    """
    with style():
        height = 0.9 + 0.27 * sum(max(1, len(seeds)) for seeds in scores.values())
        figure, axes = panels(len(METRICS), 3, 3.4, height)
        for i, (metric, ax) in enumerate(zip(METRICS, axes, strict=True)):
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
    """Return actions used against clutter moved of every policy, on the same axes everywhere.

    One panel has all heaps; one follows for each number of objects.
    """
    counts: list[int | None] = [None, *(condition.counts if len(condition.counts) > 1 else [])]
    found = [
        {
            name: scores
            for name in condition.policies
            if (scores := condition.scores_of(name, TRADEOFF, count))
        }
        for count in counts
    ]
    limits = _limits([scores for panel in found for scores in panel.values()])
    columns = min(len(counts), 4)
    with style():
        figure, axes = panels(len(counts), columns, PRINTED_WIDTH / columns, 2.4)
        for i, (ax, count, panel) in enumerate(zip(axes, counts, found, strict=True)):
            _tradeoff_panel(ax, panel, limits)
            ax.set_title(f"{count} objects" if count else f"{condition.name}, all heaps")
            if i % columns == 0:
                ax.set_ylabel(display(TRADEOFF[1]).label)
            if i + columns >= len(counts):
                ax.set_xlabel("actions used")
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=5, fontsize=8)
    return figure


def draw_reliability(curves: Mapping[str, Floats]) -> Figure:
    """Return predicted chances of success against what happened, and how often each was predicted.

    Args:
        curves: By name: mean prediction, share of successes and number (b, 3) of each bin.
    """
    with style():
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
    ax.set_yticks(ticks, list(scores))
    ax.tick_params(axis="y", length=0)
    ax.spines["left"].set_visible(False)
    ax.grid(axis="x", **_RULES)
    ax.set_axisbelow(True)
    ax.invert_yaxis()


def _limits(found: Sequence[Scores]) -> dict[str, tuple[float, float]]:
    """Return the ends of both axes: by the means, since intervals of few seeds may be far wider."""
    limits = {}
    for metric in TRADEOFF:
        means = [one[metric].mean * display(metric).scale for one in found]
        margin = 0.12 * (max(means) - min(means) or 1)
        limits[metric] = (min(means) - margin, max(means) + 2 * margin)
    return limits


def _tradeoff_panel(
    ax: Axes, found: Mapping[str, Scores], limits: Mapping[str, tuple[float, float]]
) -> None:
    across, up = (limits[metric] for metric in TRADEOFF)
    for name, (colour, mark) in policy_marks(found).items():
        (x, *ends), (y, *heights) = (
            _scaled(found[name][metric], display(metric).scale) for metric in TRADEOFF
        )
        ax.plot(np.clip(ends, *across), [y, y], color=colour, linewidth=1, alpha=0.6)
        ax.plot([x, x], np.clip(heights, *up), color=colour, linewidth=1, alpha=0.6)
        ax.plot([x], [y], mark, color=colour, markersize=5.5, label=name)
    ax.set(xlim=across, ylim=up)
    ax.grid(**_RULES)
    ax.set_axisbelow(True)


def _scaled(estimate: Estimate, scale: float) -> tuple[float, float, float]:
    return estimate.mean * scale, estimate.ci_low * scale, estimate.ci_high * scale
