"""Scores as dots with their confidence intervals, one panel for each metric."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from mechsearch.evaluation.metrics import HIGHER_IS_BETTER, METRICS, Estimate
from mechsearch.evaluation.summary import SummaryRow
from mechsearch.report.figures import COLOURS, GREY, grid, style, to_svg
from mechsearch.report.tables import Scores, display
from mechsearch.types import MechSearchError


def draw_intervals(scores: Mapping[str, Sequence[Scores]], highlight: Sequence[str] = ()) -> str:
    """Return an SVG with policies in rows and metrics in panels.

    Args:
        scores: Each policy's scores, one for every seed.
        highlight: Policies drawn in colour; the others are grey.
    """
    with style():
        height = 0.9 + 0.27 * sum(max(1, len(seeds)) for seeds in scores.values())
        figure, axes = grid(len(METRICS), 3, 3.4, height)
        for i, (metric, ax) in enumerate(zip(METRICS, axes, strict=True)):
            _panel(ax, metric, scores, highlight)
            if i % 3:
                ax.set_yticklabels([])
    return to_svg(figure)


def draw_summary(rows: Sequence[SummaryRow]) -> str:
    """Return an SVG of a summary's rows, one dot for every seed; what learnt is in colour.

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
    return draw_intervals({name: list(s.values()) for name, s in scores.items()}, list(trained))


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


def _panel(
    ax: Axes, metric: str, scores: Mapping[str, Sequence[Scores]], highlight: Sequence[str]
) -> None:
    scale, row, ticks = display(metric).scale, 0.0, []
    for name, seeds in scores.items():
        colour = COLOURS[highlight.index(name) % len(COLOURS)] if name in highlight else GREY
        ticks.append(row + (len(seeds) - 1) / 2)
        for values in seeds:
            if metric in values:
                _mark(ax, values[metric], scale, row, colour)
            row += 1
        row += 0.5
    arrow = "more is better →" if HIGHER_IS_BETTER[metric] else "← less is better"
    ax.set_title(display(metric).label)
    ax.set_xlabel(arrow, fontsize=8, color=GREY)
    ax.set_yticks(ticks, list(scores))
    ax.tick_params(axis="y", length=0)
    ax.spines["left"].set_visible(False)
    ax.grid(axis="x", color="#e3e5e8", linewidth=0.8)
    ax.set_axisbelow(True)
    ax.invert_yaxis()


def _mark(ax: Axes, estimate: Estimate, scale: float, row: float, colour: str) -> None:
    if not np.isnan(estimate.ci_low):
        low, high = estimate.ci_low * scale, estimate.ci_high * scale
        ax.plot([low, high], [row, row], color=colour, solid_capstyle="round", linewidth=2.4)
    ax.plot([estimate.mean * scale], [row], "o", color=colour, markersize=5.5)
