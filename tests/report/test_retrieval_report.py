"""Reports of retrieval: its own figures, filmstrips of its failures, apart from uncovering."""

import re
from pathlib import Path

import pytest

from mechsearch.cli import main
from mechsearch.evaluation.episodes import METRICS, RETRIEVAL_METRICS, Estimate
from mechsearch.findings.analysis import analyse
from mechsearch.findings.experiment import read_experiment
from mechsearch.report.contents import document, shown_modes
from mechsearch.report.document import Paragraph, to_html, to_pdf
from mechsearch.report.figures import draw_scores


def report(*sources: Path, **models):
    return document(analyse(read_experiment(*sources)), "T", models or None)


def test_a_mixed_report_has_both_in_sections_and_tables_of_their_own(
    loose: Path, retrievals: Path, models
) -> None:
    mixed = report(loose, retrievals, **{"single": models, "single-retrieval": models})
    assert [section.title for section in mixed.sections] == [
        "What beat what", "Actions used against clutter moved",
        "Targets retrieved against clutter moved", "Scores", "How episodes end", "Episodes",
        "How this was made",
    ]  # fmt: skip
    text = to_html(mixed)
    assert "In retrieval from single heaps:" in text
    assert "In retrieval: An episode that ends with the target in the hand" in text
    assert re.search(r"heap \d+ of \d+ objects, 80% hidden at the start; 1 push, 1 grasp", text)
    assert to_pdf(mixed).startswith(b"%PDF")


def test_a_report_of_retrieval_says_nothing_of_uncovering(retrievals: Path, models) -> None:
    found = report(retrievals, **{"single-retrieval": models})
    text = to_html(found)
    for word in ("Actions used", "back and forth", "visibility", "uncovered"):
        assert word not in text
    notes = [b.text for s in found.sections for b in s.blocks if isinstance(b, Paragraph)]
    assert any(note.startswith("A target is retrieved within so many attempts") for note in notes)


def test_the_two_most_common_failures_are_shown(make_retrieval, tmp_path: Path) -> None:
    from mechsearch.evaluation.episodes import save_episodes

    save_episodes(tmp_path / "weak.npz", make_retrieval("weak", "slipped"))
    condition = read_experiment(tmp_path).conditions["single-retrieval"]
    assert shown_modes(condition) == ("success", "slipped")


@pytest.mark.parametrize(
    ("metrics", "titles"),
    [
        (METRICS, METRICS), (("reward",), METRICS), (RETRIEVAL_METRICS, RETRIEVAL_METRICS),
        ((*METRICS, *RETRIEVAL_METRICS), dict.fromkeys((*METRICS, *RETRIEVAL_METRICS))),
    ],
)  # fmt: skip
def test_scores_have_a_panel_for_what_was_to_be_done(metrics, titles) -> None:
    scores = {"p": [dict.fromkeys(metrics, Estimate(0.5, 0.4, 0.6, 10))]}
    assert len(draw_scores(scores).axes) == len(titles)


def test_the_title_says_what_was_to_be_done(loose: Path, retrievals: Path, tmp_path: Path) -> None:
    titles = []
    for sources in ([loose], [retrievals], [loose, retrievals]):
        out = tmp_path / "r.html"
        main(["report", *map(str, sources), "--out", str(out), "--no-pictures"])
        titles.append(re.search("<h1>(.*)</h1>", out.read_text())[1])
    assert titles == [
        "Uncovering a target in a heap", "Retrieving a target from a heap",
        "Uncovering and retrieving a target in a heap",
    ]  # fmt: skip
