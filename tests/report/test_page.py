import base64
import io
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from PIL import Image

from mechsearch.report.page import Report, page, pictured, trained, write_page
from mechsearch.types import MechSearchError

VOID = {"meta", "img", "br"}


class Checker(HTMLParser):
    """Collects what a browser would load, and complains about tags that do not match."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.images: list[dict[str, str]] = []
        self.tags: list[str] = []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        if tag == "img":
            self.images.append(dict(attrs))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def text(evaluations, models) -> str:
    curves = {"A curve.": "<svg xmlns='http://www.w3.org/2000/svg'/>"}
    notes = ("Made <by> hand.",)
    return page(Report("Lid & cube", evaluations, models, curves, notes))


@pytest.fixture(scope="module")
def parsed(text: str) -> Checker:
    checker = Checker()
    checker.feed(text)
    assert checker.open == []
    return checker


def test_nothing_is_fetched_and_nothing_is_run(text: str, parsed: Checker) -> None:
    assert not {"script", "link", "iframe", "object", "video"} & set(parsed.tags)
    assert all(image["src"].startswith("data:image/") for image in parsed.images)
    outside = text.replace("http://www.w3.org/2000/svg", "")
    assert not re.search(r"https?://|url\(|@import", outside)


def test_every_picture_is_whole_and_described(parsed: Checker) -> None:
    assert len(parsed.images) == 2 + 3 * 5
    for image in parsed.images:
        assert len(image["alt"]) > 5
        kind, content = image["src"].split(";base64,")
        raw = base64.b64decode(content, validate=True)
        if kind == "data:image/png":
            Image.open(io.BytesIO(raw)).verify()


def test_the_page_says_what_beat_what(text: str) -> None:
    assert "In reward, method beats random" in text
    assert "method learnt from 3,000 actions, none of them on these heaps." in text
    assert "▲" in text
    assert "95 %" in text


def test_what_users_wrote_is_escaped(text: str) -> None:
    assert "<h1>Lid &amp; cube</h1>" in text
    assert "Made &lt;by&gt; hand." in text


def test_the_same_report_gives_the_same_page(evaluations) -> None:
    report = Report("Again", evaluations)
    assert page(report) == page(report)


def test_worst_median_and_best_are_chosen_by_rank(evaluations) -> None:
    rewards = {e.heap_seed: e.rewards.sum() for e in evaluations["method"].episodes}
    heaps = {rank: seed for rank, (_, seed) in pictured(evaluations["method"]).items()}
    assert rewards[heaps["worst"]] == min(rewards.values())
    assert rewards[heaps["best"]] == max(rewards.values())
    better = sum(reward > rewards[heaps["median"]] for reward in rewards.values())
    assert better in (5, 6)


def test_without_a_trained_policy_the_best_one_is_the_subject(evaluations) -> None:
    assert trained(evaluations) == ["method"]
    scripted = {name: e for name, e in evaluations.items() if name != "method"}
    assert trained(scripted) == ["teacher-spiral"]


def test_a_single_policy_is_reported_too(evaluations) -> None:
    assert "nothing to be compared with" in page(Report("One", {"idle": evaluations["idle"]}))


def test_a_comparison_across_machines_says_so(evaluations) -> None:
    alike = page(Report("Alike", evaluations))
    assert "crosses machines" not in alike
    idle = evaluations["idle"]
    own = {**idle.header.get("fingerprint", {}), "processor": "another"}
    other = replace(idle, header={**idle.header, "fingerprint": own})
    text = page(Report("Apart", {**evaluations, "idle": other}))
    assert "idle came about with processor another" in text


def test_no_evaluation_is_refused_and_nothing_is_written(tmp_path: Path) -> None:
    with pytest.raises(MechSearchError, match="no evaluation to report"):
        write_page(tmp_path / "report.html", Report("None", {}))
    assert list(tmp_path.iterdir()) == []
