"""The learning curves of all finished runs as one table."""

import csv
from collections.abc import Iterable, Iterator
from pathlib import Path

from mechsearch.evaluation.episodes import GRASP_METRICS, METRICS
from mechsearch.files import locked, read_lines, write_whole
from mechsearch.files.layout import CONFIG_FILE, METRICS_FILE
from mechsearch.training.config import load_config

COLUMNS = (
    "condition", "variant", "seed", "step", "metric", "mean", "ci_low", "ci_high", "heaps"
)  # fmt: skip

Row = tuple[str, str, int, int, str, float, float, float, int]


def write_curves(path: Path, runs: Iterable[Path]) -> None:
    """Write the table anew; several processes may do so at once.

    Args:
        path: The table (.csv).
        runs: Directories of the runs that are over; asked for once nobody else is at the table.
    """
    with locked(path):
        rows = sorted(row for run in runs for row in curve(run))

        def write(partial: Path) -> None:
            with partial.open("w", newline="", encoding="utf-8") as file:
                writer = csv.writer(file, lineterminator="\n")
                writer.writerow(COLUMNS)
                writer.writerows(
                    [f"{cell:.6g}" if isinstance(cell, float) else str(cell) for cell in row]
                    for row in rows
                )

        write_whole(path, write)


def curve(run: Path) -> Iterator[Row]:
    """Yield the points of a run's curve: every metric on the held-out heaps that are watched."""
    config = load_config(run / CONFIG_FILE)
    condition = run.parent.parent.name
    for record in read_lines(run / METRICS_FILE):
        if record["kind"] != "held_out":
            continue
        for metric in (*METRICS, *(name for name in GRASP_METRICS if name in record)):
            numbers = [float(record[metric + end]) for end in ("", "_ci_low", "_ci_high")]
            mean, low, high = numbers
            yield (
                condition, config.name, config.seed, record["step"], metric, mean, low, high,
                record["heaps"],
            )  # fmt: skip
