"""Actions used against clutter moved, for every policy, by condition and number of objects."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mechsearch.evaluation.metrics import Estimate
from mechsearch.report.bootstrap import mean_over_seeds_and_heaps
from mechsearch.report.experiment import Condition, Experiment
from mechsearch.report.figures import PRINTED_WIDTH, colour, grid, marker, style
from mechsearch.report.tables import display

ACROSS, UP = "episode_actions", "clutter_moved_m"
COLUMNS = (
    "condition",
    "objects",
    "policy",
    "seeds",
    "metric",
    "mean",
    "ci_low",
    "ci_high",
    "heaps",
)


def draw_tradeoff(condition: Condition) -> Figure:
    """Return one panel for all heaps and one for each number of objects, on the same axes."""
    counts: list[int | None] = [None, *(condition.counts if len(condition.counts) > 1 else [])]
    panels = [
        {name: found for name in condition.trials if (found := estimates(condition, name, count))}
        for count in counts
    ]
    limits = _limits([found for panel in panels for found in panel.values()])
    columns = min(len(counts), 4)
    with style():
        figure, axes = grid(len(counts), columns, PRINTED_WIDTH / columns, 2.4)
        for i, (ax, count, panel) in enumerate(zip(axes, counts, panels, strict=True)):
            _panel(ax, panel, limits)
            ax.set_title(f"{count} objects" if count else f"{condition.name}, all heaps")
            if i % columns == 0:
                ax.set_ylabel(display(UP).label)
            if i + columns >= len(counts):
                ax.set_xlabel("actions used")
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


def _limits(found: Sequence[Mapping[str, Estimate]]) -> dict[str, tuple[float, float]]:
    """Return the ends of both axes: by the means, since intervals of few seeds may be far wider."""
    limits = {}
    for metric in (ACROSS, UP):
        means = [one[metric].mean * display(metric).scale for one in found]
        margin = 0.12 * (max(means) - min(means) or 1)
        limits[metric] = (min(means) - margin, max(means) + 2 * margin)
    return limits


def _panel(
    ax: Axes, found: Mapping[str, Mapping[str, Estimate]], limits: Mapping[str, tuple[float, float]]
) -> None:
    for name, both in found.items():
        (x, left, right), (y, low, high) = (
            [
                value * display(metric).scale
                for value in (both[metric].mean, both[metric].ci_low, both[metric].ci_high)
            ]
            for metric in (ACROSS, UP)
        )
        across, up = np.clip([left, right], *limits[ACROSS]), np.clip([low, high], *limits[UP])
        ax.plot(across, [y, y], color=colour(name), linewidth=1, alpha=0.6)
        ax.plot([x, x], up, color=colour(name), linewidth=1, alpha=0.6)
        ax.plot([x], [y], marker(name), color=colour(name), markersize=5.5, label=name)
    ax.set(xlim=limits[ACROSS], ylim=limits[UP])
    ax.grid(color="#e3e5e8", linewidth=0.8)
    ax.set_axisbelow(True)
