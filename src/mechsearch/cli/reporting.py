"""`mechsearch report`."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mechsearch.cli.command import Command, models_of, wrote
from mechsearch.cli.evaluation import named
from mechsearch.evaluation import episodes, summary
from mechsearch.evaluation.episodes import Evaluation
from mechsearch.report import curves, page, tables
from mechsearch.report.intervals import draw_summary
from mechsearch.runs import write_text
from mechsearch.types import MechSearchError


@dataclass(frozen=True)
class Report(Command):
    """Write one HTML page from recorded episodes and run directories, or plot a summary.

    Attributes:
        sources: Evaluations (.npz), run directories, and folders of either; or one summary (.csv).
        out: Page (.html) to write, or plot (.svg) of a summary.
        title: Of the page.
        objects: Object set for the pictures; the one that the evaluations name by default.
        pictures: Whether to draw episodes.
    """

    sources: Annotated[tuple[Path, ...], tyro.conf.Positional]
    out: Path = Path("report.html")
    title: str = "Uncovering a target in a heap"
    objects: str = ""
    pictures: bool = True

    def run(self) -> None:
        """Write the page or the plot."""
        if [source.suffix for source in self.sources] == [".csv"]:
            svg = draw_summary(summary.read(self.sources[0]))
            write_text(self.out, svg)
        else:
            write_report(self)
        wrote(self.out)


def write_report(options: Report) -> None:
    """Write the page of a report."""
    evaluations = named(episodes.load(path) for path in _files(options.sources))
    if not evaluations:
        raise MechSearchError(
            f"no evaluation (.npz) under {', '.join(map(str, options.sources)) or 'nothing'}"
        )
    runs = [curves.read_run(path) for path in _runs(options.sources)]
    first = next(iter(evaluations.values()))
    models = models_of(first, options.objects) if options.pictures else None
    drawn = learning_curves(runs, evaluations)
    page.write_page(options.out, page.Report(options.title, evaluations, models, drawn))


def learning_curves(
    runs: Sequence[curves.Run], evaluations: dict[str, Evaluation]
) -> dict[str, str]:
    """Return SVG of the curves of runs by caption."""
    references = {
        name: scores
        for name, scores in tables.scores_of(evaluations).items()
        if not evaluations[name].header["trained"]
    }
    drawn = {
        "Evaluations during training, without noise or teachers. Grey: policies that do not learn, "
        "on the heaps of the scores above.": curves.draw_evaluations(runs, references)
    }
    drawn |= {
        f"Training of {run.name}, seed {run.seed}.": curves.draw_training(run) for run in runs
    }
    return {caption: svg for caption, svg in drawn.items() if svg}


def _files(sources: Sequence[Path]) -> list[Path]:
    missing = [source for source in sources if not source.exists()]
    if missing:
        raise MechSearchError(f"there is nothing at {missing[0]}")
    found = [
        path
        for source in sources
        for path in ([source] if source.is_file() else sorted(source.rglob("*.npz")))
    ]
    # A run directory may hold demonstrations, which are no evaluations.
    return [path for path in dict.fromkeys(found) if not _in_run(path)]


def _in_run(path: Path) -> bool:
    return any((folder / curves.METRICS_FILE).exists() for folder in path.parents)


def _runs(sources: Sequence[Path]) -> list[Path]:
    logs = [log for source in sources for log in sorted(source.rglob(curves.METRICS_FILE))]
    return list(dict.fromkeys(log.parent for log in logs))
