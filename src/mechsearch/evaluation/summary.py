"""The table of all results: one row per metric, variant and training seed, none pooled."""

import csv
from collections.abc import Iterable
from dataclasses import astuple, dataclass, fields
from pathlib import Path

from mechsearch.evaluation.episodes import Evaluation
from mechsearch.evaluation.metrics import GRASP_METRICS, METRICS, score
from mechsearch.files import locked, write_whole
from mechsearch.types import MechSearchError


@dataclass(frozen=True, order=True)
class SummaryRow:
    """One score; the first six fields name it, and a later row of that name replaces it.

    Attributes:
        experiment: Name of the comparison that the row belongs to.
        condition: Condition of the heaps, such as "single".
        variant: Such as "method", "ddpg", "teacher-straight", "random".
        seed: Training seed, or evaluation seed where nothing was trained.
        actions: Training actions behind the policy; 0 where nothing was trained.
        metric: Name in `evaluation.metrics.METRICS` or `GRASP_METRICS`.
        mean: Over the held-out heaps.
        ci_low: Lower end of the 95 % interval over heaps.
        ci_high: Upper end.
    """

    experiment: str
    condition: str
    variant: str
    seed: int
    actions: int
    metric: str
    mean: float
    ci_low: float
    ci_high: float

    @property
    def key(self) -> tuple[str, str, str, int, int, str]:
        """What names the row."""
        return self.experiment, self.condition, self.variant, self.seed, self.actions, self.metric


SUMMARY_COLUMNS = tuple(field.name for field in fields(SummaryRow))


def rows_of(experiment: str, evaluation: Evaluation) -> list[SummaryRow]:
    """Return the rows that an evaluation enters into a summary.

    There is one for each of `METRICS`, and of `GRASP_METRICS` where they were measured.
    """
    header, scores = evaluation.header, score(evaluation.episodes)
    seed = header["training_seed"] if header["trained"] else header["seed"]
    place = (experiment, header["condition"], header["name"])
    return [
        SummaryRow(
            *place,
            header["seed"] if seed is None else seed,
            header["training_actions"],
            metric,
            *(scores[metric].mean, scores[metric].ci_low, scores[metric].ci_high),
        )
        for metric in (*METRICS, *(name for name in GRASP_METRICS if name in scores))
    ]


def read(path: Path) -> list[SummaryRow]:
    """Return the rows of a summary, in the file's order.

    Raises:
        MechSearchError: If the file is missing or not a summary; the message names the line.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            lines = list(csv.reader(file))
    except FileNotFoundError:
        raise MechSearchError(f"no summary at {path}") from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise MechSearchError(f"the summary at {path} cannot be read: {error}") from None
    if not lines or tuple(lines[0]) != SUMMARY_COLUMNS:
        found = ",".join(lines[0]) if lines else "nothing"
        raise MechSearchError(f"{path} begins with {found}; expected {','.join(SUMMARY_COLUMNS)}")
    return [_row(path, number, line) for number, line in enumerate(lines[1:], start=2)]


def merge(path: Path, new: Iterable[SummaryRow]) -> list[SummaryRow]:
    """Add rows to a summary, replacing those of the same name, and return all, sorted.

    The file is written whole; one that cannot be read is left as it is. Processes that merge at the
    same time wait for each other, and no row is lost.

    Raises:
        MechSearchError: If the file is there but is not a summary.
    """
    with locked(path):
        kept = {row.key: row for row in (read(path) if path.exists() else [])}
        kept |= {row.key: row for row in new}
        merged = [kept[key] for key in sorted(kept)]
        _write(path, merged)
    return merged


def _write(path: Path, merged: Iterable[SummaryRow]) -> None:
    def write(partial: Path) -> None:
        with partial.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(SUMMARY_COLUMNS)
            writer.writerows(_cells(row) for row in merged)

    write_whole(path, write)


def _cells(row: SummaryRow) -> list[str]:
    return [f"{cell:.6g}" if isinstance(cell, float) else str(cell) for cell in astuple(row)]


def _row(path: Path, number: int, cells: list[str]) -> SummaryRow:
    try:
        experiment, condition, variant, seed, actions, metric, *numbers = cells
        mean, low, high = (float(cell) for cell in numbers)
        return SummaryRow(
            experiment, condition, variant, int(seed), int(actions), metric, mean, low, high
        )
    except ValueError:
        raise MechSearchError(
            f"line {number} of {path} is {','.join(cells)!r}; expected {','.join(SUMMARY_COLUMNS)}"
        ) from None
