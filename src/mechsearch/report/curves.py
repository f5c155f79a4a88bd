"""Learning curves from a run directory's metrics."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from mechsearch.evaluation.metrics import Estimate
from mechsearch.files import read_lines, read_record
from mechsearch.files.layout import CONFIG_FILE, METRICS_FILE
from mechsearch.report.figures import COLOURS, GREY, grid, style, to_svg
from mechsearch.report.tables import display
from mechsearch.types import Floats, MechSearchError

EVALUATIONS = {"held_out": "held-out heaps", "validation": "validation heaps"}
SHOWN = ("reward", "visibility_change", "uncovered_rate", "clutter_moved_m")
_WINDOW = 15


@dataclass(frozen=True)
class Run:
    """What a training run logged.

    Attributes:
        name: Of the run's configuration.
        seed: Likewise.
        records: Lines of the log by their kind, such as "validation" or "episode".
    """

    name: str
    seed: int
    records: Mapping[str, Sequence[Mapping[str, Any]]]

    def series(self, kind: str, key: str, over: str = "step") -> tuple[Floats, Floats]:
        """Return steps, or another number, and values (n,) of one number in one kind of record."""
        pairs = [(r[over], r[key]) for r in self.records.get(kind, ()) if key in r]
        steps, values = np.array(pairs, np.float64).reshape(-1, 2).T
        return steps, values

    def keys(self, kind: str) -> list[str]:
        """Return the names of all numbers in one kind of record, in their first order."""
        names: dict[str, None] = {}
        for record in self.records.get(kind, ()):
            names |= {k: None for k, v in record.items() if isinstance(v, int | float)}
        return [name for name in names if name != "step"]


def read_run(directory: Path) -> Run:
    """Read a run directory.

    Raises:
        MechSearchError: If it holds no run, or its log is damaged.
    """
    config = read_record(directory / CONFIG_FILE, "training configuration")
    records: dict[str, list[Mapping[str, Any]]] = {}
    try:
        for record in read_lines(directory / METRICS_FILE):
            records.setdefault(record["kind"], []).append(record)
    except (ValueError, KeyError, TypeError) as error:
        raise MechSearchError(
            f"the log at {directory / METRICS_FILE} is damaged: {error}"
        ) from None
    return Run(str(config.get("name", directory.name)), int(config.get("seed", 0)), records)


def draw_evaluations(
    runs: Sequence[Run], references: Mapping[str, Mapping[str, Estimate]] | None = None
) -> str | None:
    """Return an SVG of the evaluations during training, or None if there were none.

    Args:
        runs: Each a colour; solid on held-out heaps, dashed on validation heaps.
        references: Scores of policies that do not learn, drawn as grey levels.
    """
    if not any(run.records.get(kind) for run in runs for kind in EVALUATIONS):
        return None
    names = list(dict.fromkeys(run.name for run in runs))
    with style():
        figure, axes = grid(len(SHOWN), 2, 4.8, 2.7)
        for metric, ax in zip(SHOWN, axes, strict=True):
            for run in runs:
                _draw_run(ax, run, metric, COLOURS[names.index(run.name) % len(COLOURS)])
            draw_levels(ax, metric, references or {})
            ax.set_title(display(metric).label)
            ax.set_xlabel("training step")
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4)
        return to_svg(figure)


def draw_training(run: Run) -> str | None:
    """Return an SVG of what went on in training, or None if nothing was logged.

    Reinforcement: each episode's return, the critic's first Q against the return that followed,
    the share of saturated actions, and who chose the actions. Pushes: each episode's return and its
    number of pushes, and what each fit learnt from and found. Of episodes, running means.
    """
    if not run.records.get("episode"):
        return None
    panels = _PUSHES if "pushes" in run.keys("episode") else _reinforcement(run)
    with style():
        figure, axes = grid(len(panels), 2, 4.8, 2.6)
        for ax, panel in zip(axes, panels, strict=True):
            _draw_panel(ax, run, panel)
        return to_svg(figure)


@dataclass(frozen=True)
class _Panel:
    """Some numbers of one kind of record, beside each other."""

    title: str
    kind: str
    keys: Sequence[str]
    over: str = "step"
    shares: bool = False


_PUSHES = (
    _Panel("return of each episode", "episode", ["return"], "executed"),
    _Panel("pushes in each episode", "episode", ["pushes"], "executed"),
    _Panel("loss of each fit", "fit", ["loss"]),
    _Panel("rewards to come: at once, less for occlusion", "fit", ["at_once", "by_occlusion"]),
    _Panel("pushes learnt from", "fit", ["pushes"]),
    _Panel("actions", "fit", ["executed", "simulated"]),
)


def _reinforcement(run: Run) -> Sequence[_Panel]:
    choices = [key for key in run.keys("episode") if key.startswith("chosen_")]
    expected = "Q at the start, and the return that followed"
    return (
        _Panel("return of each episode", "episode", ["return"]),
        _Panel(expected, "episode", ["q_start", "return_start"]),
        _Panel("share of saturated actions", "episode", ["saturated"], shares=True),
        _Panel("who chose the actions", "episode", choices, shares=True),
    )


def _draw_panel(ax: Axes, run: Run, panel: _Panel) -> None:
    window = _WINDOW if panel.kind == "episode" else 1
    for key, colour in zip(panel.keys, COLOURS, strict=False):
        steps, values = run.series(panel.kind, key, panel.over)
        if len(steps):
            label = key.removeprefix("chosen_").replace("_", " ")
            ax.plot(steps, running_mean(values, window), color=colour, label=label)
    ax.set_title(panel.title)
    ax.set_xlabel("training action")
    if panel.shares:
        ax.set_ylim(-0.02, 1.02)
    if len(panel.keys) > 1 and ax.lines:
        ax.legend(loc="best", fontsize=8)


def running_mean(values: Floats, window: int) -> Floats:
    """Return the mean of each value and those before it, at most `window` in all (n,)."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    ends = np.arange(1, len(values) + 1)
    starts = np.maximum(ends - window, 0)
    mean: Floats = (sums[ends] - sums[starts]) / (ends - starts)
    return mean


def _draw_run(ax: Axes, run: Run, metric: str, colour: str) -> None:
    for (kind, heaps), line in zip(EVALUATIONS.items(), ("-", "--"), strict=True):
        steps, values = run.series(kind, metric)
        if len(steps):
            ax.plot(
                steps,
                values * display(metric).scale,
                line,
                color=colour,
                marker="o",
                markersize=3.5,
                label=f"{run.name}, seed {run.seed}, {heaps}",
            )


def draw_levels(ax: Axes, metric: str, references: Mapping[str, Mapping[str, Estimate]]) -> None:
    """Draw scores of policies that do not learn as grey levels, named at the right."""
    scale = display(metric).scale
    levels = {name: scores[metric].mean * scale for name, scores in references.items()}
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
        while len(groups) > 1 and _bottom(groups[-1], gap) - _top(groups[-2], gap) < gap:
            last = groups.pop()
            groups[-1] += last
    return [_bottom(group, gap) + i * gap for group in groups for i in range(len(group))]


def _bottom(group: Sequence[float], gap: float) -> float:
    return sum(group) / len(group) - gap * (len(group) - 1) / 2


def _top(group: Sequence[float], gap: float) -> float:
    return _bottom(group, gap) + gap * (len(group) - 1)
