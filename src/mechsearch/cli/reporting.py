"""`mechsearch report`."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mechsearch.cli.command import Command, bars, models_of, say, wrote
from mechsearch.evaluation.episodes import Evaluation, read_summary
from mechsearch.files import check_place, write_text
from mechsearch.findings.analysis import analyse
from mechsearch.findings.experiment import Experiment, read_experiment
from mechsearch.pictures.film import Models
from mechsearch.pictures.replay import replayed, weighed_again
from mechsearch.report.contents import document
from mechsearch.report.document import to_html, write_pdf
from mechsearch.report.figures import draw_summary, to_svg


@dataclass(frozen=True)
class Report(Command):
    """Write one HTML page from recorded episodes and run directories, or plot a summary.

    Of a folder that `mechsearch sweep` wrote: its claims, figures, scores and failures, as a page,
    as a PDF, and as SVG and CSV files in a folder beside them. Where episodes are drawn the folder
    also has a page in three dimensions of the worst, median and best one.

    Attributes:
        sources: A sweep's folder; or evaluations (.npz), run directories, and folders of either; or
            one summary (.csv).
        out: Page (.html) to write, or plot (.svg) of a summary; report.html or report.svg by
            default.
        title: Of the page; by default it says what was to be done.
        objects: Object set for the pictures; the one that the evaluations name by default.
        pictures: Whether to draw episodes.
        pdf: The same for print; of a sweep's folder beside the page by default.
    """

    writes = (("pdf", (".pdf",)),)

    sources: Annotated[tuple[Path, ...], tyro.conf.Positional]
    out: Path | None = None
    title: str = ""
    objects: str = ""
    pictures: bool = True
    pdf: Path | None = None

    def run(self) -> None:
        """Write the page or the plot, and say what was found."""
        of_summary = [source.suffix.lower() for source in self.sources] == [".csv"]
        out = self.out or Path("report.svg" if of_summary else "report.html")
        check_place(out, (".svg",) if of_summary else (".html", ".htm"))
        if of_summary:
            write_text(out, to_svg(draw_summary(read_summary(self.sources[0]))))
            wrote(out)
            return
        found = analyse(read_experiment(*self.sources))
        planned = found.experiment.plan is not None
        models = self._models(found.experiment) if self.pictures else None
        title = self.title or _title(found.experiment)
        with bars() as progress:
            text = document(found, title, models, replayed, weighed_again, progress)
        beside = out.with_suffix("") if planned or text.pages else None
        for name, page in text.pages.items():
            write_text(out.with_suffix("") / f"{name}.html", page)
        write_text(out, to_html(text, out.stem))
        pdf = self.pdf or (out.with_suffix(".pdf") if planned else None)
        if pdf:
            write_pdf(pdf, text)
        if beside and planned:
            for name, svg in text.drawings.items():
                write_text(beside / f"{name}.svg", svg)
            for name, rows in found.numbers.items():
                write_text(beside / f"{name}.csv", _csv(rows))
        for line in found.lines:
            say(line)
        for path in filter(None, (out, pdf, beside)):
            wrote(path)

    def _models(self, experiment: Experiment) -> dict[str, Models]:
        """Return the objects by name of each condition that has episodes to draw."""
        recorded = {
            name: [one.header for one in condition.scored if one.path.exists()]
            for name, condition in experiment.conditions.items()
        }
        return {
            name: models_of(Evaluation(headers[0], ()), self.objects)
            for name, headers in recorded.items()
            if headers
        }


def _title(experiment: Experiment) -> str:
    aims = {condition.retrieves for condition in experiment.conditions.values()}
    if aims == {True}:
        return "Retrieving a target from a heap"
    done = "Uncovering and retrieving" if True in aims else "Uncovering"
    return f"{done} a target in a heap"


def _csv(rows: Sequence[Sequence[str]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()
