import io
import re
from collections.abc import Callable, Mapping
from html import escape
from pathlib import Path

import pytest
from PIL import Image

from mechsearch.findings.analysis import analyse, lead, made_table
from mechsearch.findings.experiment import read_experiment
from mechsearch.findings.failure_modes import SUCCESS, UNFINISHED
from mechsearch.findings.tables import MINUS, Table
from mechsearch.objects.model import ObjectModel
from mechsearch.report.contents import document, exemplary_episode, mode_pictures
from mechsearch.report.document import (
    Document,
    Paragraph,
    Picture,
    Section,
    to_html,
    to_pdf,
    write_pdf,
)
from mechsearch.types import MechSearchError
from tests.pictures.test_page import read

Models = Mapping[str, ObjectModel]


@pytest.fixture(scope="module")
def report(sweep: Path, models: Models) -> Document:
    return document(analyse(read_experiment(sweep)), "All & everything", {"single": models})


def test_page_and_print_have_the_same_sections(report: Document) -> None:
    assert [section.title for section in report.sections] == [
        "What the paper claims",
        "What this project asks besides",
        "Learning",
        "Actions used against clutter moved",
        "Scores",
        "How episodes end",
        "Episodes",
        "How this was made",
    ]
    text = to_html(report)
    assert text.count("<h2") == 8
    assert text.count("<img") == 6 + len(_pictures(report, bytes))
    assert "All &amp; everything" in text


def test_the_worst_median_and_best_episode_are_in_the_report_and_on_a_page_beside_it(
    sweep: Path, report: Document
) -> None:
    (page,) = report.pages.values()
    method = read_experiment(sweep).conditions["single"].policies["method"][0]
    rewards = sorted(method.values["reward"])
    (*shown,) = read(page)["episodes"]
    assert [one["name"] for one in shown] == ["worst", "median", "best"]
    ends = [one["reward"][-1] for one in shown]
    assert ends == pytest.approx(
        [rewards[0], rewards[(len(rewards) - 1) // 2], rewards[-1]], abs=1e-3
    )
    text = to_html(report, "my report")
    assert "<summary>The worst, median and best episode of method" in text
    assert '<a href="my%20report/episodes-single.html">' in text
    assert f'srcdoc="{escape(page)}"' in text


def _pictures(report: Document, kind: type) -> list[Picture]:
    return [
        block
        for section in report.sections
        for block in section.blocks
        if isinstance(block, Picture) and isinstance(block.content, kind)
    ]


def test_files_alone_rebuild_page_and_print_byte_by_byte(
    write_sweep: Callable[..., Path], tmp_path: Path, models: Models
) -> None:
    gains = {"single": {"method": 0.8, "teacher-spiral": 0.9, "random": 0.2, "idle": 0.0}}
    folder = write_sweep(tmp_path / "s", gains, seeds=2)
    made = []
    for _ in range(2):
        report = document(analyse(read_experiment(folder)), "Twice", {"single": models})
        assert _pictures(report, bytes)
        made.append((to_html(report), to_pdf(report)))
    assert made[0] == made[1]


def test_the_lead_says_what_was_scored_and_what_is_missing(
    write_sweep: Callable[..., Path], tmp_path: Path
) -> None:
    folder = write_sweep(tmp_path / "s", {"single": {"method": 0.5, "idle": 0.0}}, seeds=1)
    text = lead(read_experiment(folder))
    assert text.startswith("2 policies on 30 held-out single heaps, all from the same starts.")
    assert "Those that learnt executed 8,000 actions in training." in text
    assert "Planned and not scored yet: single: ddpg-seed0, single: no-asymmetry-seed0" in text


def test_a_sweep_of_few_variants_is_reported_and_says_so(
    write_sweep: Callable[..., Path], tmp_path: Path
) -> None:
    folder = write_sweep(tmp_path / "s", {"single": {"idle": 0.0}}, grasps=False)
    found = analyse(read_experiment(folder))
    report = document(found, "Little")
    assert to_html(report).count("not measured") > len(found.paper)
    assert to_pdf(report).startswith(b"%PDF")


def test_how_each_policy_came_about_is_one_row(sweep: Path) -> None:
    single = read_experiment(sweep).conditions["single"]
    rows = {row[0]: row[1:] for row in made_table(single).rows}
    assert list(rows) == list(single.policies)
    assert rows["method"][:5] == ("0, 1, 2", "8,000", "none", "30", "none")
    assert rows["plus"][:3] == ("0, 1, 2", "8,000", "90,000 to 90,002")
    assert rows["idle"][:2] == ("0", "none")


def test_nothing_says_where_the_files_lay(sweep: Path, report: Document) -> None:
    assert str(sweep) not in to_html(report)


def test_the_episode_of_a_success_is_the_median_one(sweep: Path, models: Models) -> None:
    condition = read_experiment(sweep).conditions["single"]
    found = exemplary_episode(condition, SUCCESS)
    assert found is not None
    scored, index = found
    assert scored.name == "method"
    assert scored.modes[index].mode == SUCCESS
    rewards = sorted(
        float(one.values["reward"][i])
        for one in condition.policies["method"]
        for i, episode in enumerate(one.modes)
        if episode.mode == SUCCESS
    )
    assert scored.values["reward"][index] == rewards[len(rewards) // 2]
    (picture,) = mode_pictures(condition, models)
    assert isinstance(picture, Picture)
    assert isinstance(picture.content, bytes)
    assert picture.caption.startswith("Success: method, seed")
    assert str(scored.heaps[index]) in picture.caption
    Image.open(io.BytesIO(picture.content)).verify()


def test_a_mode_that_no_policy_shows_has_no_picture(sweep: Path) -> None:
    condition = read_experiment(sweep).conditions["single"]
    assert exemplary_episode(condition, "target lost") is None
    assert exemplary_episode(condition, UNFINISHED) is not None


def test_a_share_has_an_interval_even_if_all_episodes_end_alike(sweep: Path) -> None:
    condition = read_experiment(sweep).conditions["single"]
    never = condition.estimate("idle", "uncovered_rate")
    assert never.mean == 0
    assert 0 < never.ci_high < 0.2
    often = condition.estimate("method", "uncovered_rate")
    assert 0 <= often.ci_low <= often.mean <= often.ci_high <= 1


def test_a_pdf_has_pages_a_title_and_no_date_of_its_making() -> None:
    table = Table("Caption", ("a", "b"), tuple((f"row {i}", "1\n0 to 2") for i in range(80)))
    made = Document("Title", "Lead", [Section("One", [Paragraph(f"Text {MINUS}1"), table])])
    content = to_pdf(made)
    assert len(re.findall(rb"/Type /Page\b", content)) == 3
    assert b"20000101" in content
    assert content == to_pdf(made)


def test_a_pdf_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    write_pdf(tmp_path / "a.pdf", Document("Title", "Lead"))
    assert [path.name for path in tmp_path.iterdir()] == ["a.pdf"]
    (tmp_path / "b.pdf").mkdir()
    with pytest.raises(MechSearchError, match=r"b\.pdf: Is a directory"):
        write_pdf(tmp_path / "b.pdf", Document("Title", "Lead"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.pdf", "b.pdf"]


def test_tables_of_words_break_into_lines_on_the_page() -> None:
    table = Table("", ("claim", "verdict"), (("It <is>.", "holds"),), [["better"]], words=True)
    made = Document("T", "L", [Section("S", [table])])
    text = to_html(made)
    assert '<table class="words">' in text
    assert "It &lt;is&gt;." in text
    assert "<caption>" not in text


def test_html_is_escaped_and_names_rows_and_columns() -> None:
    table = Table("<b>", ("p", "x"), (("<script>", "1\n0 to 2"),), [["better"]])
    text = to_html(Document("T", "L", [Section("S", [table])]))
    assert "<script>" not in text
    assert "<b>" not in text
    assert '<th scope="row">&lt;script&gt;</th>' in text
    assert '<td class="better">1<small>0 to 2</small></td>' in text
