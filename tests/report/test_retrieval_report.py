"""Reports of retrieval: its own figures, filmstrips of its failures, apart from uncovering."""

import json
import re
from pathlib import Path

import pytest

from mechsearch.cli import main
from mechsearch.evaluation.episodes import METRICS, RETRIEVAL_METRICS, Estimate, save_episodes
from mechsearch.findings.analysis import analyse
from mechsearch.findings.experiment import read_experiment
from mechsearch.report.contents import document, shown_modes
from mechsearch.report.document import Paragraph, to_html, to_pdf
from mechsearch.report.figures import RUN_METRICS, draw_curves, draw_scores


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


def test_runs_that_retrieve_have_curves_of_what_is_retrieved(
    make_retrieval, tmp_path: Path
) -> None:
    header = {"trained": True, "training_seed": 0, "training_actions": 100}
    save_episodes(tmp_path / "ours.npz", make_retrieval("ours-jaws-85", "slipped", **header))
    run = tmp_path / "run"
    run.mkdir()
    (run / "config.json").write_text(json.dumps({"name": "ours", "seed": 0}))
    lines = [
        {"step": step, "kind": "validation", "reward": 0.1, "retrieved_within_5": step / 100}
        for step in (0, 50)
    ]
    (run / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    found = read_experiment(tmp_path)
    assert list(found.conditions["single-retrieval"].runs) == ["ours"]
    titles = [ax.get_title("left") for ax in draw_curves(found, RUN_METRICS, ["ours"], 2).axes]
    assert titles[2] == "single-retrieval: within 5 attempts [%]"
    assert [row[5:7] for row in analyse(found).numbers["learning"][1:] if "within" in row[5]] == [
        ("retrieved_within_5", "0"), ("retrieved_within_5", "0.5"),
    ]  # fmt: skip
