import base64
import io
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from PIL import Image

from mechsearch.evaluation.episodes import save_episodes
from mechsearch.findings.analysis import analyse
from mechsearch.findings.experiment import read_experiment
from mechsearch.report.contents import document
from mechsearch.report.document import to_html, to_pdf
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


def page(*sources: Path, title: str = "T", **models) -> str:
    return to_html(document(analyse(read_experiment(*sources)), title, models or None))


@pytest.fixture(scope="module")
def text(loose: Path, models) -> str:
    return page(loose, title="Lid & cube", single=models)


@pytest.fixture(scope="module")
def parsed(text: str) -> Checker:
    checker = Checker()
    checker.feed(text)
    assert checker.open == []
    return checker


def test_nothing_is_fetched_and_nothing_but_an_episode_is_run(text: str, parsed: Checker) -> None:
    assert not {"script", "link", "object", "video"} & set(parsed.tags)
    assert re.findall(r"<iframe [^>]*?(\w+)=\"[^\"]{200}", text) == ["srcdoc"]
    assert not re.search(r"<iframe [^>]*?src=", text)
    assert all(image["src"].startswith("data:image/") for image in parsed.images)
    outside = text.replace("http://www.w3.org/2000/svg", "")
    assert not re.search(r"https?://|url\(|@import", outside)


def test_every_picture_is_whole_and_described(parsed: Checker) -> None:
    # Two figures, a success, and start and end on three heaps of each of five policies.
    assert len(parsed.images) == 2 + 1 + 5
    for image in parsed.images:
        assert len(image["alt"]) > 5
        kind, content = image["src"].split(";base64,")
        raw = base64.b64decode(content, validate=True)
        if kind == "data:image/png":
            Image.open(io.BytesIO(raw)).verify()


def test_the_page_says_what_beat_what_and_prints_the_same(text: str, loose: Path) -> None:
    assert "In reward, method beats idle" in text
    assert "Those that learnt executed 3,000 actions in training." in text
    assert "▲" in text
    assert "95 %" in text
    assert "<h1>Lid &amp; cube</h1>" in text
    assert "What the paper claims" not in text
    found = analyse(read_experiment(loose))
    assert to_pdf(document(found, "T")).startswith(b"%PDF")
    assert all(line in text for line in found.lines)


def test_the_same_files_give_the_same_page(loose: Path) -> None:
    assert page(loose) == page(loose)


def test_without_a_trained_policy_the_best_one_is_the_subject(loose: Path) -> None:
    assert read_experiment(loose).conditions["single"].subjects == ["method"]
    scripted = [loose / f"{name}.npz" for name in ("idle", "random", "teacher-spiral")]
    assert read_experiment(*scripted).conditions["single"].subjects == ["teacher-spiral"]


def test_a_single_policy_is_reported_too(loose: Path) -> None:
    assert "nothing to be compared with" in page(loose / "idle.npz")


def test_a_comparison_across_machines_says_so(loose: Path, evaluations, tmp_path: Path) -> None:
    assert "crosses machines" not in page(loose)
    idle = evaluations["idle"]
    own = {**idle.header.get("fingerprint", {}), "processor": "another"}
    save_episodes(tmp_path / "idle.npz", replace(idle, header={**idle.header, "fingerprint": own}))
    text = page(loose / "method.npz", tmp_path / "idle.npz")
    assert "single idle, seed 0 came about with processor another" in text


def test_conditions_are_told_apart_and_runs_go_with_the_heaps_they_learnt_from(
    sweep: Path, tmp_path: Path
) -> None:
    kinds = [sweep / kind / "evaluations" / "method-seed0-8000.npz" for kind in ("single", "dual")]
    found = read_experiment(*kinds)
    assert list(found.conditions) == ["single", "dual"]
    assert "In dual heaps:" not in page(kinds[0])
    run = sweep / "single" / "runs" / "method-seed0"
    assert list(read_experiment(kinds[0], run).conditions["single"].runs) == ["method"]
    assert "Evaluations during training" in page(kinds[0], run)
    with pytest.raises(MechSearchError, match="does not say that it learnt from the heaps"):
        read_experiment(*kinds, run)


def test_lengths_of_training_are_told_apart_and_seeds_are_not(
    make_evaluation, tmp_path: Path
) -> None:
    def write(name: str, seed: int, actions: int) -> None:
        header = {"trained": True, "training_seed": seed, "training_actions": actions}
        save_episodes(
            tmp_path / f"{name}-{seed}-{actions}.npz", make_evaluation(name, 0.5, **header)
        )

    write("method", 0, 8000)
    write("method", 1, 8012)
    write("ddpg", 0, 4000)
    write("ddpg", 0, 8000)
    policies = read_experiment(tmp_path).conditions["single"].policies
    assert {name: [one.seed for one in seeds] for name, seeds in policies.items()} == {
        "method": [0, 1],
        "ddpg, seed 0, 4,000 actions": [0],
        "ddpg, seed 0, 8,000 actions": [0],
    }


def test_no_evaluation_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MechSearchError, match=r"no evaluation \(.npz\) under"):
        read_experiment(tmp_path)
