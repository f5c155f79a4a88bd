"""Tables as data: numbers in the units that people read, policies in rows."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np

from mechsearch.evaluation.episodes import (
    GRASP_METRICS,
    EpisodeRecord,
    Estimate,
    metrics_of,
    score,
    score_by_count,
)

Scores = Mapping[str, Estimate]
MINUS = "\N{MINUS SIGN}"
TRADEOFF = ("episode_actions", "clutter_moved_m")
RETRIEVAL_TRADEOFF = ("clutter_moved_m", "retrieved_within_5")
PAPER_METRICS = ("reward", "visibility_change", "episode_actions", "graspability_change")
"""What the paper's Figure 4 shows."""

EPISODES_NOTE = (
    "Every episode counts, lost targets and failed simulations included; an unfinished one counts "
    "all its actions. Clutter moved is the path length of a non-target object, averaged over all, "
    "those off the table included; these count as still."
)
ATTEMPTS_NOTE = (
    "A target is retrieved within so many attempts if it was alone in the hand after at most so "
    "many grasps of it. Removals are attempts to put another object aside, and wrong objects came "
    "up in place of the target."
)


@dataclass(frozen=True)
class Display:
    """How a metric is shown.

    Attributes:
        label: With its unit.
        scale: Factor from the recorded unit to the shown one.
        digits: After the decimal point.
    """

    label: str
    scale: float
    digits: int


DISPLAYS = {
    "reward": Display("reward", 1, 1),
    "visibility_change": Display("visibility gained", 1, 2),
    "uncovered_rate": Display("uncovered [%]", 100, 0),
    "episode_actions": Display("actions", 1, 1),
    "clutter_moved_m": Display("clutter moved [cm]", 100, 1),
    "target_moved_m": Display("target moved [cm]", 100, 1),
    "graspability_change": Display("graspability gained", 1, 2),
    "retrieval_before": Display("retrieved at the start [%]", 100, 0),
    "retrieval_after": Display("retrieved at the end [%]", 100, 0),
    "retrieved_within_1": Display("retrieved at once [%]", 100, 0),
    "retrieved_within_3": Display("within 3 attempts [%]", 100, 0),
    "retrieved_within_5": Display("within 5 attempts [%]", 100, 0),
    "grasp_attempts": Display("attempts", 1, 1),
    "push_actions": Display("pushes", 1, 1),
    "removals": Display("removals", 1, 1),
    "wrong_objects": Display("wrong objects", 1, 2),
}


@dataclass(frozen=True)
class Table:
    """Text in rows and columns; the first column names the rows.

    Attributes:
        caption: What the table shows.
        columns: Their headings (C,).
        rows: Cells (R, C); a line break parts a number from its interval.
        marks: What each cell after the first means (R, C - 1): "better", "worse" or "".
        words: Whether the cells are sentences rather than numbers.
        widths: Share of each column in the width (C,) on paper; empty leaves it to the cells.
    """

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    marks: Sequence[Sequence[str]] = ()
    words: bool = False
    widths: Sequence[float] = ()


def display(metric: str) -> Display:
    """Return how a metric is shown; reward terms are shown as rewards are."""
    return DISPLAYS.get(metric, Display(metric.removeprefix("term_").replace("_", " "), 1, 1))


def number(metric: str, value: float, signed: bool = False) -> str:
    """Return a value of a metric in its shown unit, with a true minus sign."""
    shown = display(metric)
    text = f"{value * shown.scale + 0.0:{'+' if signed else ''}.{shown.digits}f}"
    if float(text) == 0:
        text = text.lstrip("+-")
    return text.replace("-", MINUS)


def cell(metric: str, estimate: Estimate | None, signed: bool = False) -> str:
    """Return a mean with its interval on a second line; nothing where it was not measured."""
    if estimate is None:
        return ""
    return _with_interval(estimate, lambda end: number(metric, end, signed), "\n{} to {}")


def difference_text(metric: str, estimate: Estimate) -> str:
    """Return a difference in one line, with its interval if it has one."""
    return _with_interval(estimate, lambda end: number(metric, end, True), " ({} to {})")


def percent(estimate: Estimate) -> str:
    """Return a share, with its interval if it has one."""
    # What rounds to nothing has no sign.
    return _with_interval(estimate, lambda e: f"{round(e, 2) + 0.0:.0%}", " ({} to {})")


def plain_numbers(estimate: Estimate | None) -> list[str]:
    """Return a mean and the ends of its interval for a CSV file; empty where not measured."""
    return [f"{end:.6g}" for end in astuple(estimate)[:3]] if estimate else [""] * 3


def policy_table(caption: str, scores: Mapping[str, Scores], metrics: Iterable[str]) -> Table:
    """Return policies in rows and metrics in columns."""
    columns = {metric: display(metric).label for metric in metrics}
    rows = (
        (name, *(cell(metric, row.get(metric)) for metric in columns))
        for name, row in scores.items()
    )
    return Table(caption, ("policy", *columns.values()), tuple(rows))


def score_table(
    scores: Mapping[str, Scores],
    caption: str = "Scores",
    facts: Mapping[str, Sequence[str]] | None = None,
) -> Table:
    """Return policies in rows, and the metrics of their goal that there are in columns.

    Args:
        scores: Of each policy, by its name.
        caption: Of the table.
        facts: Columns to put before the scores: of each policy, by their headings.
    """
    measured = dict.fromkeys(metric for row in scores.values() for metric in row)
    table = policy_table(caption, scores, metrics_of(measured))
    before = facts or {}
    rows = (
        (name, *(column[i] for column in before.values()), *cells)
        for i, (name, *cells) in enumerate(table.rows)
    )
    return replace(table, columns=("policy", *before, *table.columns[1:]), rows=tuple(rows))


def terms_table(scores: Mapping[str, Scores], caption: str = "Reward terms") -> Table:
    """Return policies in rows and the terms of the reward, with their sum, in columns."""
    terms = dict.fromkeys(m for row in scores.values() for m in row if m.startswith("term_"))
    return policy_table(caption, scores, (*terms, "reward"))


def count_table(scores: Mapping[str, Mapping[int, Scores]], metric: str, where: str = "") -> Table:
    """Return policies in rows and one metric by number of objects in columns.

    Args:
        scores: Of each policy, by its name and the number of objects.
        metric: To show.
        where: Words for the caption, such as " in single heaps".
    """
    counts = sorted({count for found in scores.values() for count in found})
    rows = [
        (name, *(cell(metric, found.get(count, {}).get(metric)) for count in counts))
        for name, found in scores.items()
    ]
    columns = ("policy", *(f"{count} objects" for count in counts))
    return Table(f"{display(metric).label}{where}, by number of objects", columns, tuple(rows))


def evaluation_tables(
    recorded: Mapping[str, Sequence[EpisodeRecord]], brief: bool = False
) -> list[Table]:
    """Return what is said of policies when they were evaluated, by their names.

    Args:
        recorded: Episodes of each, with or without grasps.
        brief: Whether to leave out reward terms and scores by number of objects.
    """
    retrieving = {n: found for n, found in recorded.items() if all(r.retrieval for r in found)}
    uncovering = {n: found for n, found in recorded.items() if n not in retrieving}
    return [
        table
        for caption, group in (("Scores", uncovering), ("Scores of retrieval", retrieving))
        if group
        for table in _tables_of_goal(caption, group, brief)
    ]


def _tables_of_goal(
    caption: str, recorded: Mapping[str, Sequence[EpisodeRecord]], brief: bool
) -> list[Table]:
    scores = {name: score(records) for name, records in recorded.items()}
    shown = [score_table(scores, caption)]
    if all(record.grasp for records in recorded.values() for record in records):
        shown.append(_grasp_table(recorded, scores))
    if not brief:
        by_count = {name: score_by_count(records) for name, records in recorded.items()}
        shown.append(terms_table(scores))
        metrics = metrics_of(next(iter(scores.values())))
        shown += [
            count_table(by_count, metric) for metric in metrics if metric not in GRASP_METRICS
        ]
    return shown


def _grasp_table(
    recorded: Mapping[str, Sequence[EpisodeRecord]], scores: Mapping[str, Scores]
) -> Table:
    """Return policies in rows, and what grasps are worth before and after in columns."""
    columns = (
        "policy", "graspability before", "after", "change", "clutter removed",
        "retrieved before [%]", "after [%]",
    )  # fmt: skip
    rows = []
    for name, found in scores.items():
        grasps = [record.grasp for record in recorded[name] if record.grasp]
        means = np.mean([(g.before, g.after, g.alone) for g in grasps], axis=0)
        before, after, alone = (f"{mean:.2f}" for mean in means)
        change = cell("graspability_change", found["graspability_change"], signed=True)
        metrics = ("retrieval_before", "retrieval_after")
        retrieved = [cell(metric, found[metric]) for metric in metrics]
        rows.append((name, before, after, change, alone, *retrieved))
    return Table("Graspability and retrieval of the target", columns, tuple(rows))


def to_text(table: Table) -> str:
    """Return a table in plain columns, intervals behind their means, signs in ASCII."""
    flat = [[_one_line(text) for text in row] for row in (table.columns, *table.rows)]
    widths = [max(len(row[i]) for row in flat) for i in range(len(table.columns))]
    lines = [
        "  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip()
        for row in flat
    ]
    rule = "  ".join("-" * width for width in widths)
    text = "\n".join([table.caption, "", lines[0], rule, *lines[1:]]) + "\n"
    return text.replace(MINUS, "-")


def to_markdown(table: Table) -> str:
    """Return a table in Markdown, its caption above it, intervals behind their means."""
    rows = [table.columns, ["---"] * len(table.columns), *table.rows]
    lines = [f"| {' | '.join(map(_one_line, row))} |" for row in rows]
    return "\n".join([table.caption, "", *lines]) + "\n"


def _with_interval(estimate: Estimate, shown: Callable[[float], str], form: str) -> str:
    mean, *ends = (shown(end).replace("-", MINUS) for end in astuple(estimate)[:3])
    return mean if np.isnan(estimate.ci_low) else mean + form.format(*ends)


def _one_line(text: str) -> str:
    mean, _, rest = text.partition("\n")
    return f"{mean} ({rest})" if rest else mean
