"""Tables of scores for a terminal, a text file or a page."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from mechsearch.evaluation.episodes import Evaluation
from mechsearch.evaluation.metrics import (
    GRASP_METRICS,
    METRICS,
    Estimate,
    score,
    score_by_count,
)

Scores = Mapping[str, Estimate]
MINUS = "\N{MINUS SIGN}"


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
}

NOTE = (
    "Means over heaps with 95 % confidence intervals (Student's t; Wilson's for the share "
    "uncovered). Every episode counts, lost targets and failed simulations included; an unfinished "
    "one counts all its actions. Clutter moved is the path length of a non-target object."
)


@dataclass(frozen=True)
class Table:
    """Text in rows and columns; the first column names the rows.

    Attributes:
        caption: What the table shows.
        columns: Their headings (C,).
        rows: Cells (R, C); a line break parts a number from its interval.
    """

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


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


def interval(metric: str, estimate: Estimate, signed: bool = False) -> str:
    """Return "low to high" of an estimate in its shown unit; nothing where there is none."""
    if np.isnan(estimate.ci_low):
        return ""
    low, high = (number(metric, end, signed) for end in (estimate.ci_low, estimate.ci_high))
    return f"{low} to {high}"


def cell(metric: str, estimate: Estimate, signed: bool = False) -> str:
    """Return a mean with its interval on a second line."""
    text = f"{number(metric, estimate.mean, signed)}\n{interval(metric, estimate, signed)}"
    return text.rstrip("\n")


def score_table(scores: Mapping[str, Scores], caption: str = "Scores") -> Table:
    """Return policies in rows and `METRICS` in columns, then those of `GRASP_METRICS` there are."""
    grasped = [name for name in GRASP_METRICS if any(name in row for row in scores.values())]
    metrics = (*METRICS, *grasped)
    columns = ("policy", *(display(metric).label for metric in metrics))
    rows = [
        (name, *(cell(metric, row[metric]) if metric in row else "" for metric in metrics))
        for name, row in scores.items()
    ]
    return Table(caption, columns, tuple(rows))


def terms_table(scores: Mapping[str, Scores], caption: str = "Reward terms") -> Table:
    """Return policies in rows and the terms of the reward, with their sum, in columns."""
    terms = [name for name in next(iter(scores.values())) if name.startswith("term_")]
    columns = ("policy", *(display(term).label for term in terms), "reward")
    rows = [
        (name, *(cell(metric, values[metric]) for metric in (*terms, "reward")))
        for name, values in scores.items()
    ]
    return Table(caption, columns, tuple(rows))


def count_table(evaluations: Mapping[str, Evaluation], metric: str) -> Table:
    """Return policies in rows and one metric by number of objects in columns."""
    scores = {name: score_by_count(e.episodes) for name, e in evaluations.items()}
    counts = sorted({count for values in scores.values() for count in values})
    columns = ("policy", *(f"{count} objects" for count in counts))
    rows = [
        (name, *(cell(metric, values[c][metric]) if c in values else "" for c in counts))
        for name, values in scores.items()
    ]
    return Table(f"{display(metric).label}, by number of objects", columns, tuple(rows))


def scores_of(evaluations: Mapping[str, Evaluation]) -> dict[str, dict[str, Estimate]]:
    """Return every policy's scores."""
    return {name: score(evaluation.episodes) for name, evaluation in evaluations.items()}


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
    """Return a table in Markdown, intervals behind their means."""
    rows = [table.columns, ("---",) * len(table.columns), *table.rows]
    return "\n".join("| " + " | ".join(map(_one_line, row)) + " |" for row in rows) + "\n"


def to_html(table: Table, marks: Sequence[Sequence[str]] = (), words: bool = False) -> str:
    """Return a table in HTML.

    Args:
        table: The table.
        marks: Class name of each cell after the first (R, C - 1), such as "better".
        words: Whether the cells are sentences, which break into lines.
    """
    head = "".join(f'<th scope="col">{escape(column)}</th>' for column in table.columns)
    body = []
    for i, (name, *cells) in enumerate(table.rows):
        classes = marks[i] if marks else [""] * len(cells)
        data = "".join(map(_html_cell, cells, classes))
        body.append(f'<tr><th scope="row">{escape(name)}</th>{data}</tr>')
    caption = f"<caption>{escape(table.caption)}</caption>" if table.caption else ""
    kind = ' class="words"' if words else ""
    return (
        f'<div class="wide"><table{kind}>{caption}<thead><tr>{head}'
        f"</tr></thead><tbody>{''.join(body)}</tbody></table></div>"
    )


def _html_cell(text: str, mark: str) -> str:
    mean, _, rest = text.partition("\n")
    small = f"<small>{escape(rest)}</small>" if rest else ""
    return f"<td{f' class={mark!r}' if mark else ''}>{escape(mean)}{small}</td>"


def _one_line(text: str) -> str:
    mean, _, rest = text.partition("\n")
    return f"{mean} ({rest})" if rest else mean
