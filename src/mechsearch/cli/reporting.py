"""`mechsearch report`."""

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mechsearch.cli.command import Command, models_of, say, wrote
from mechsearch.cli.evaluation import named
from mechsearch.evaluation import episodes, summary
from mechsearch.evaluation.episodes import Evaluation
from mechsearch.files import write_text
from mechsearch.files.layout import METRICS_FILE
from mechsearch.objects.model import ObjectModel
from mechsearch.report import curves, document, experiment_report, page, tables
from mechsearch.report.experiment import Experiment, is_experiment, read_experiment
from mechsearch.report.intervals import draw_summary
from mechsearch.report.pdf import write_pdf
from mechsearch.types import MechSearchError


@dataclass(frozen=True)
class Report(Command):
    """Write one HTML page from recorded episodes and run directories, or plot a summary.

    Of a folder that `mechsearch sweep` wrote: its claims, figures, scores and failures, as a page,
    as a PDF, and as SVG and CSV files in a folder beside them.

    Attributes:
        sources: A sweep's folder; or evaluations (.npz), run directories, and folders of either; or
            one summary (.csv).
        out: Page (.html) to write, or plot (.svg) of a summary.
        title: Of the page.
        objects: Object set for the pictures; the one that the evaluations name by default.
        pictures: Whether to draw episodes.
        pdf: The same for print, of a sweep's folder; beside the page by default.
    """

    sources: Annotated[tuple[Path, ...], tyro.conf.Positional]
    out: Path = Path("report.html")
    title: str = "Uncovering a target in a heap"
    objects: str = ""
    pictures: bool = True
    pdf: Path | None = None

    def run(self) -> None:
        """Write the page or the plot."""
        if any(is_experiment(source) for source in self.sources):
            write_experiment(self)
            return
        if self.pdf:
            raise MechSearchError(
                f"--pdf {self.pdf} needs a folder that `mechsearch sweep` wrote; "
                f"{', '.join(map(str, self.sources)) or 'nothing'} is none"
            )
        if [source.suffix for source in self.sources] == [".csv"]:
            svg = draw_summary(summary.read(self.sources[0]))
            write_text(self.out, svg)
        else:
            write_report(self)
        wrote(self.out)


def write_experiment(options: Report) -> None:
    """Write page, PDF, figures and numbers of a sweep's folder, and say what was found."""
    if len(options.sources) > 1:
        raise MechSearchError(
            f"{len(options.sources)} sources; a sweep's folder is reported by itself"
        )
    analysis = experiment_report.analyse(read_experiment(options.sources[0]))
    models = _models(analysis.experiment, options.objects) if options.pictures else None
    text = experiment_report.document(analysis, options.title, models)
    write_text(options.out, document.to_html(text))
    pdf = options.pdf or options.out.with_suffix(".pdf")
    write_pdf(pdf, text)
    beside = options.out.with_suffix("")
    for name, svg in analysis.figures.items():
        write_text(beside / f"{name}.svg", svg)
    for name, rows in experiment_report.numbers(analysis).items():
        write_text(beside / f"{name}.csv", _csv(rows))
    for ruling in (*analysis.paper, *analysis.goals):
        say(f"{ruling.verdict:>14}: {ruling.words}")
    for path in (options.out, pdf, beside):
        wrote(path)


def write_report(options: Report) -> None:
    """Write the page of a report."""
    evaluations = named(episodes.load_episodes(path) for path in _files(options.sources))
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


def _csv(rows: Sequence[Sequence[str]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def _models(experiment: Experiment, named_set: str) -> dict[str, Mapping[str, ObjectModel]]:
    """Return the objects of each condition by name."""
    found = {}
    for condition in experiment.conditions.values():
        first = next(iter(condition.trials.values()))[0]
        found[condition.name] = models_of(episodes.load_episodes(first.path), named_set)
    return found


def _files(sources: Sequence[Path]) -> list[Path]:
    missing = [source for source in sources if not source.exists()]
    if missing:
        raise MechSearchError(f"there is nothing at {missing[0]}")
    found = [
        path
        for source in sources
        for path in ([source] if source.is_file() else sorted(source.rglob("*.npz")))
    ]
    return list(dict.fromkeys(found))


def _runs(sources: Sequence[Path]) -> list[Path]:
    logs = [log for source in sources for log in sorted(source.rglob(METRICS_FILE))]
    return list(dict.fromkeys(log.parent for log in logs))
