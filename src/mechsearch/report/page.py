"""One HTML file that holds everything: verdicts, scores, curves and pictures of episodes."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from string import Template

import numpy as np
from PIL import Image

from mechsearch.evaluation.episodes import EpisodeRecord, Evaluation
from mechsearch.files import write_whole
from mechsearch.files.fingerprint import mixed
from mechsearch.objects.model import ObjectModel
from mechsearch.pictures.filmstrip import Film, FilmConfig, start_and_end
from mechsearch.report import tables, verdicts
from mechsearch.report.document import Picture, picture_html, section_html
from mechsearch.report.intervals import draw_intervals
from mechsearch.report.style import PAGE
from mechsearch.types import MechSearchError

PICTURED = ("worst", "median", "best")


@dataclass(frozen=True)
class Report:
    """What a page shows.

    Attributes:
        title: At its head.
        evaluations: On the same heaps, by the name to print; those of interest first.
        models: Objects by name, to draw the episodes; None leaves the pictures out.
        curves: SVG of learning curves by caption.
        notes: Paragraphs on how it all came about.
    """

    title: str
    evaluations: Mapping[str, Evaluation]
    models: Mapping[str, ObjectModel] | None = None
    curves: Mapping[str, str] | None = None
    notes: Sequence[str] = ()


def write_page(path: Path, report: Report) -> None:
    """Write a report as one HTML file that needs no other, whole or not at all.

    Raises:
        MechSearchError: If there is nothing to report, or the policies ran on different heaps.
    """
    text = page(report)

    def write(partial: Path) -> None:
        partial.write_text(text, encoding="utf-8")

    write_whole(path, write)


def page(report: Report) -> str:
    """Return the HTML text of a report."""
    if not report.evaluations:
        raise MechSearchError("there is no evaluation to report; expected at least one")
    subjects = trained(report.evaluations)
    scores = tables.scores_of(report.evaluations)
    sections = [
        section_html("What beat what", _verdicts(report.evaluations, subjects)),
        section_html("Scores", _scores(report.evaluations, scores, subjects)),
    ]
    if report.curves:
        figures = [Picture(svg, caption, caption) for caption, svg in report.curves.items()]
        sections.append(section_html("Learning", "".join(map(picture_html, figures))))
    if report.models is not None:
        sections.append(
            section_html("Episodes", _episodes(report.evaluations, report.models, subjects[0]))
        )
    sections.append(section_html("How this was made", _made(report)))
    return Template(PAGE).substitute(
        title=escape(report.title),
        lead=escape(_lead(report.evaluations, subjects)),
        body="\n".join(sections),
    )


def trained(evaluations: Mapping[str, Evaluation]) -> list[str]:
    """Return the policies that learnt, or else the one with the highest reward."""
    learnt = [name for name, e in evaluations.items() if e.header.get("trained")]
    scores = tables.scores_of(evaluations)
    return learnt or [max(scores, key=lambda name: scores[name]["reward"].mean)]


def pictured(evaluation: Evaluation) -> dict[str, tuple[str, int]]:
    """Return on which heaps (condition, seed) a policy did worst, middling and best by reward."""
    ranked = sorted(evaluation.episodes, key=lambda record: float(record.rewards.sum()))
    places = np.linspace(0, len(ranked) - 1, len(PICTURED)).round().astype(int)
    return {
        name: (ranked[place].condition, ranked[place].heap_seed)
        for name, place in zip(PICTURED, places, strict=True)
    }


def _lead(evaluations: Mapping[str, Evaluation], subjects: Sequence[str]) -> str:
    first = next(iter(evaluations.values()))
    counts = sorted({record.count for record in first.episodes})
    held_out = first.header.get("split") == "held-out"
    sizes = f"{', '.join(map(str, counts[:-1]))} or {counts[-1]}" if counts[1:] else f"{counts[0]}"
    lead = (
        f"{len(evaluations)} policies had to uncover a target in the same {len(first.episodes)} "
        f"{'held-out ' if held_out else ''}heaps of {sizes} {first.header.get('object_set', '')} "
        "objects, each from the same start."
    )
    learnt = [
        f"{name} learnt from {evaluations[name].header['training_actions']:,} actions"
        for name in subjects
        if evaluations[name].header.get("training_actions", 0)
    ]
    apart = ", none of them on these heaps" if held_out else ""
    return lead + (f" {'; '.join(learnt)}{apart}." if learnt else "")


def _verdicts(evaluations: Mapping[str, Evaluation], subjects: Sequence[str]) -> str:
    if len(evaluations) < 2:
        return "<p>A single policy has nothing to be compared with.</p>"
    parts = []
    for name in subjects:
        parts.append(f'<p class="verdict">{escape(verdicts.sentence(name, evaluations))}</p>')
        standing = verdicts.standing(name, evaluations)
        if standing:
            parts.append("<ul>" + "".join(f"<li>{escape(s)}</li>" for s in standing) + "</ul>")
        parts.append(tables.to_html(*verdicts.verdict_table(name, evaluations)))
    return "".join(parts) + f'<p class="note">{escape(verdicts.NOTE)}</p>'


def _scores(
    evaluations: Mapping[str, Evaluation],
    scores: Mapping[str, tables.Scores],
    subjects: Sequence[str],
) -> str:
    svg = draw_intervals({name: [values] for name, values in scores.items()}, subjects)
    figure = Picture(
        svg,
        "Means and confidence intervals of each policy and metric; the table below has the numbers",
        "Means with 95 % confidence intervals over heaps.",
    )
    parts = [picture_html(figure), tables.to_html(tables.score_table(scores))]
    parts += [
        tables.to_html(tables.count_table(evaluations, metric))
        for metric in ("reward", "visibility_change", "uncovered_rate")
    ]
    parts.append(tables.to_html(tables.terms_table(scores)))
    return "".join(parts) + f'<p class="note">{escape(tables.NOTE)}</p>'


def _episodes(
    evaluations: Mapping[str, Evaluation], models: Mapping[str, ObjectModel], chooser: str
) -> str:
    heaps = pictured(evaluations[chooser])
    parts = [
        f"<p>Three heaps, chosen by rank and not by hand: where {escape(chooser)} had its "
        f"{', its '.join(PICTURED[:-1])} and its {PICTURED[-1]} reward. Left: the start, with the "
        "visible part of the target in green and the path of the end effector in blue, from ring "
        "to dot. Right: the end.</p>"
    ]
    for name, evaluation in evaluations.items():
        records = {(record.condition, record.heap_seed): record for record in evaluation.episodes}
        figures = "".join(picture_html(_picture(records[heap], models)) for heap in heaps.values())
        parts.append(f'<h3>{escape(name)}</h3><div class="row">{figures}</div>')
    return "".join(parts)


def _picture(record: EpisodeRecord, models: Mapping[str, ObjectModel]) -> Picture:
    image = start_and_end(Film(record, models, FilmConfig(size=224, captions=False)))
    first, last = record.occlusions[0], record.occlusions[-1]
    actions = len(record.actions)
    caption = (
        f"{first:.0%} → {last:.0%} hidden, {actions} action{'s' if actions > 1 else ''} "
        f"({record.end}), reward {tables.number('reward', float(record.rewards.sum()))}"
    )
    alt = f"Start and end of an episode among {len(record.objects)} objects: {caption}"
    return Picture(_encoded(image), alt, caption)


def _encoded(image: Image.Image) -> bytes:
    """Return an image as a PNG of 256 colours, a third of the size of a full one."""
    buffer = io.BytesIO()
    image.quantize(256, dither=Image.Dither.NONE).save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def _made(report: Report) -> str:
    rows = []
    for name, evaluation in report.evaluations.items():
        header = evaluation.header
        training = header.get("training_actions", 0)
        rows.append(
            (
                name,
                str(header.get("policy", "")),
                f"{training:,}" if training else "none",
                str(header.get("seed", "")),
                ", ".join(header.get("keys", ())),
            )
        )
    columns = ("policy", "made from", "training actions", "seed", "observes")
    header = next(iter(report.evaluations.values())).header
    facts = {
        "heap set": header.get("heap_set"),
        "mechsearch": header.get("version"),
        "MuJoCo": header.get("engine"),
    }
    paragraphs = [f"{key}: {value}." for key, value in facts.items() if value]
    crossings = mixed({n: e.header.get("fingerprint", {}) for n, e in report.evaluations.items()})
    lines = (*report.notes, " ".join(paragraphs), *crossings)
    text = "".join(f"<p>{escape(line)}</p>" for line in lines)
    return tables.to_html(tables.Table("Policies", columns, tuple(rows))) + text
