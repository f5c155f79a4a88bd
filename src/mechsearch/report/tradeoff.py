"""Actions used against clutter moved, for every policy, by condition and number of objects."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mechsearch.evaluation.metrics import Estimate
from mechsearch.report.bootstrap import mean_over_seeds_and_heaps
from mechsearch.report.experiment import Condition, Experiment
from mechsearch.report.figures import PRINTED_WIDTH, colour, grid, marker, style
from mechsearch.report.tables import display

ACROSS, UP = "episode_actions", "clutter_moved_m"
COLUMNS = ("condition", "objects", "policy", "seeds", "metric", "mean", "ci_low", "ci_high", "heaps")


def draw_tradeoff(condition: Condition) -> Figure:
    """Return one panel for all heaps and one for each number of objects."""
    counts: list[int | None] = [None, *(condition.counts if len(condition.counts) > 1 else [])]
    columns = min(len(counts), 4)
    with style():
        figure, axes = grid(len(counts), columns, PRINTED_WIDTH / columns, 2.3)
        for i, (ax, count) in enumerate(zip(axes, counts, strict=True)):
            _panel(ax, condition, count)
            if i % columns == 0:
                ax.set_ylabel(display(UP).label)
        _share_limits(axes)
        figure.supxlabel("actions used", fontsize=9.5)
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=5, fontsize=8)
    return figure


def estimates(condition: Condition, name: str, count: int | None) -> dict[str, Estimate] | None:
    """Return both means of one policy; None if it has no heap of so many objects."""
    if count is not None and not any((t.counts == count).any() for t in condition.trials[name]):
        return None
    return {
        metric: mean_over_seeds_and_heaps(condition.matrices([name], metric, count)[0])
        for metric in (ACROSS, UP)
    }


def tradeoff_rows(experiment: Experiment) -> list[tuple[str, ...]]:
    """Return every point, headings first."""
    rows: list[tuple[str, ...]] = [COLUMNS]
    for condition in experiment.conditions.values():
        for count in (None, *condition.counts):
            for name, trials in condition.trials.items():
                for metric, estimate in (estimates(condition, name, count) or {}).items():
                    ends = (estimate.mean, estimate.ci_low, estimate.ci_high)
                    numbers = (*(f"{value:.6g}" for value in ends), str(estimate.heaps))
                    place = (condition.name, str(count or "all"), name, str(len(trials)))
                    rows.append((*place, metric, *numbers))
    return rows


def _panel(ax: Axes, condition: Condition, count: int | None) -> None:
    for name in condition.trials:
        found = estimates(condition, name, count)
        if found is None:
            continue
        (x, left, right), (y, low, high) = (
            np.array([found[m].mean, found[m].ci_low, found[m].ci_high]) * display(m).scale
            for m in (ACROSS, UP)
        )
        ax.plot([left, right], [y, y], color=colour(name), linewidth=1, alpha=0.6)
        ax.plot([x, x], [low, high], color=colour(name), linewidth=1, alpha=0.6)
        ax.plot([x], [y], marker(name), color=colour(name), markersize=5.5, label=name)
    ax.set_title(f"{count} objects" if count else f"{condition.name}, all heaps")
    ax.grid(color="#e3e5e8", linewidth=0.8)
    ax.set_axisbelow(True)


def _share_limits(axes: Sequence[Axes]) -> None:
    """Give all panels the same axes, so that they can be compared."""
    right = max(ax.get_xlim()[1] for ax in axes)
    top = max(ax.get_ylim()[1] for ax in axes)
    left = min(ax.get_xlim()[0] for ax in axes)
    for ax in axes:
        ax.set(xlim=(left, right), ylim=(min(0, -0.03 * top), top))
