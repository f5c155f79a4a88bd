import csv
import shutil
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pytest

from mechsearch.cli import main

GAINS = {"single": {"method": 0.8, "teacher-spiral": 0.9, "random": 0.2, "idle": 0.0}}


@pytest.fixture(scope="module")
def folder(write_sweep: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_sweep(tmp_path_factory.mktemp("command") / "sweep", GAINS, seeds=2)


def test_a_sweep_s_folder_becomes_a_page_a_pdf_drawings_and_numbers(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "found.html"
    main(["report", str(folder), "--out", str(page), "--no-pictures", "--title", "What we found"])
    assert "<h1>What we found</h1>" in page.read_text()
    assert page.with_suffix(".pdf").read_bytes().startswith(b"%PDF")
    beside = tmp_path / "found"
    assert sorted(path.name for path in beside.iterdir()) == [
        "ablation.svg",
        "claims.csv",
        "learning.csv",
        "learning.svg",
        "scores-single.svg",
        "tradeoff-single.svg",
        "tradeoff.csv",
    ]
    for drawing in beside.glob("*.svg"):
        assert ElementTree.parse(drawing).getroot().tag.endswith("svg")
    with (beside / "claims.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["verdict"] for row in rows} >= {"holds", "not measured"}
    said = capsys.readouterr()
    assert "not measured: The teachers are essential." in said.out
    assert {line.split("  ")[0].split(",")[0] for line in said.err.splitlines()} == {"report"}


def test_a_pdf_goes_where_it_is_asked_for(folder: Path, tmp_path: Path) -> None:
    page, paper = tmp_path / "a.html", tmp_path / "other" / "b.pdf"
    main(["report", str(folder), "--out", str(page), "--pdf", str(paper), "--no-pictures"])
    assert paper.exists()
    assert not page.with_suffix(".pdf").exists()


def refused(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    with pytest.raises(SystemExit) as stopped:
        main(["report", *words])
    assert stopped.value.code == 2
    return capsys.readouterr().err


def test_bad_sources_are_refused_in_one_line_and_nothing_is_written(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ["--out", str(tmp_path / "r.html"), "--no-pictures"]
    evaluation = str(folder / "single" / "evaluations" / "idle.npz")
    assert "reported by itself" in refused([str(folder), evaluation, *out], capsys)
    broken = Path(shutil.copytree(folder, tmp_path / "broken"))
    (broken / "single" / "evaluations" / "idle.npz").write_bytes(b"PK")
    said = refused([str(broken), *out], capsys)
    assert "idle.npz is damaged or no evaluation" in said
    assert said.count("\n") == 1
    (broken / "sweep.json").write_text("{")
    assert "plan of a sweep" in refused([str(broken), *out], capsys)
    assert [path.name for path in tmp_path.iterdir()] == ["broken"]


def test_single_evaluations_are_reported_too(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "r.html"
    words = ["report", str(folder / "single" / "evaluations"), "--out", str(page), "--no-pictures"]
    main(words)
    assert "What beat what" in page.read_text()
    assert "In reward, method beats idle" in capsys.readouterr().out
    assert [path.name for path in tmp_path.iterdir()] == ["r.html"]
    main([*words, "--pdf", str(tmp_path / "r.pdf")])
    assert (tmp_path / "r.pdf").read_bytes().startswith(b"%PDF")
