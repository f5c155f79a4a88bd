"""Where everything of a sweep is kept, and the table of its learning curves."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from mechsearch.files import (
    CURVES_FILE,
    EVALUATIONS_FOLDER,
    JOURNAL_FILE,
    PLAN_FILE,
    RUNS_FOLDER,
    SUMMARY_FILE,
    locked,
    write_text,
)
from mechsearch.findings.experiment import CURVE_COLUMNS, EVALUATIONS, curve_rows, read_run

_COLUMNS = tuple(column for column in CURVE_COLUMNS if column != "scored_on")


@dataclass(frozen=True)
class SweepFolder:
    """The layout of a sweep on disk; nothing is read or written here."""

    path: Path

    @property
    def lock(self) -> Path:
        """What a sweep at work holds locked."""
        return self.path / "sweep"

    @property
    def plan(self) -> Path:
        """What is to be carried out."""
        return self.path / PLAN_FILE

    @property
    def journal(self) -> Path:
        """Which jobs began and ended when."""
        return self.path / JOURNAL_FILE

    @property
    def summary(self) -> Path:
        """Scores of all finished evaluations."""
        return self.path / SUMMARY_FILE

    @property
    def curves(self) -> Path:
        """Learning curves of all finished runs."""
        return self.path / CURVES_FILE

    def heaps(self, condition: str) -> Path:
        """Return where a heap set is generated, if none was given."""
        return self.path / condition / "heaps.parquet"

    def run(self, condition: str, title: str) -> Path:
        """Return the directory of a run, such as "method-seed0"."""
        return self.path / condition / RUNS_FOLDER / title

    def evaluations(self, condition: str) -> Path:
        """Return the folder of a condition's recorded episodes."""
        return self.path / condition / EVALUATIONS_FOLDER


def write_curves(path: Path, runs: Iterable[Path]) -> None:
    """Write the points of all curves on held-out heaps; several processes may do so at once.

    Args:
        path: The table (.csv).
        runs: Directories of the runs that are over; asked for once nobody else is at the table.
    """
    with locked(path):
        points = (p for run in runs for p in curve_rows(run.parent.parent.name, [read_run(run)]))
        rows = [(*p[:3], *p[4:]) for p in points if p[3] == EVALUATIONS["held_out"]]
        rows.sort(key=lambda row: (row[0], row[1], int(row[2]), int(row[3]), row[4]))
        write_text(path, "".join(",".join(row) + "\n" for row in (_COLUMNS, *rows)))
