"""What a page of episodes holds, read here by other means than the page's own."""

import base64
import json
import re
import zlib
from pathlib import Path

import numpy as np
import pytest

from mechsearch.benchmark.submission import load_submission
from mechsearch.cli import main
from mechsearch.env import TaskConfig
from mechsearch.evaluation.episodes import save_episodes
from mechsearch.evaluation.rollout import EvaluationPlan, evaluate_plan, weighed_again
from mechsearch.heaps.dataset import object_set
from mechsearch.pictures.film import FilmConfig, film_of
from mechsearch.pictures.page import Shown, episode_page
from mechsearch.pictures.replay import replayed
from mechsearch.types import GRASP, PUSH, Weighed
from tests.pictures.test_retrieval_film import HEADER, record

__all__ = ["record"]
UP = np.array([0.0, 0.0, 0.03, 1.0, 0.0, 0.0, 0.0])


def read(text):
    """Return what a page shows, its arrays in place of where they are in the block of bytes."""
    told = json.loads(re.search(r'<script type="application/json"[^>]*>(.*?)</script>', text)[1])
    block = zlib.decompress(base64.b64decode(told["block"]))

    def opened(value):
        if isinstance(value, list):
            return [opened(each) for each in value]
        if not isinstance(value, dict):
            return value
        if "array" not in value:
            return {key: opened(each) for key, each in value.items()}
        count = int(np.prod(value["shape"]))
        return np.frombuffer(block, "<" + value["array"], count, value["start"]).reshape(
            value["shape"]
        )

    return opened(told["data"])


def poses_of(episode):
    """Return the poses (M, B, 7) of all bodies: differences of 16 bits, added up."""
    whole = np.cumsum(episode["poses"].astype(np.int64), axis=2).astype(np.int16)
    return whole.transpose(2, 1, 0) * np.array([5e-5] * 3 + [1 / 32767] * 4)


@pytest.fixture(scope="module")
def film(record, boxes):
    return film_of(HEADER, record, boxes.models, FilmConfig(), True, replayed)


@pytest.fixture(scope="module")
def weighed():
    push = np.array([[0.1, 0.0, 0.02], [-0.1, 0.0, 0.02]])
    return Weighed((PUSH, GRASP), (push, UP), np.array([0.25, 0.5]), 0, "a <chance>")


@pytest.fixture(scope="module")
def page(film, weighed):
    return episode_page("a & b", {"median": Shown(film, "done <so>", [None, weighed])})


def test_a_page_has_every_body_where_it_was_at_each_moment(film, page):
    (episode,) = read(page)["episodes"]
    poses = poses_of(episode)
    assert poses.shape == (len(film.moments), 3 + 5 + 1, 7)
    for i, moment in enumerate(film.moments):
        # What was put aside is far away.
        places = np.minimum(moment.poses[:, :3], 32767 * 5e-5)
        assert np.abs(poses[i, :3, :3] - places).max() <= 2.6e-5
        assert np.abs(poses[i, :3, 3:] - moment.poses[:, 3:]).max() <= 1.6e-5
        # The closed jaws while they push, the open parts of one gripper while it grasps.
        seen = poses[i, 3:, 2] < 1.6
        jaws, cup = [True] * 3 + [False] * 3, [False] * 3 + [True] * 2 + [False]
        pushing = [False] * 5 + [True]
        assert seen.tolist() in ([pushing] if moment.parts is None else [jaws, cup])
    said = [(each["step"], each["words"]) for each in episode["moments"]]
    assert said == [(moment.step, moment.words) for moment in film.moments]
    np.testing.assert_allclose(episode["tips"], film.record.ee_positions, atol=1e-5)
    assert episode["reward"][-1] == pytest.approx(film.record.rewards.sum(), abs=1e-3)


def test_the_path_of_pushes_begins_anew_after_a_grasp(page):
    began = [each.get("from") for each in read(page)["episodes"][0]["moments"]]
    assert began[:3] == [None, 0, 0]
    assert set(began[3:]) == {None}


def test_bodies_are_drawn_once_with_the_colours_that_the_renderer_shows(film):
    data = read(episode_page("t", {name: Shown(film, name) for name in ("worst", "best")}))
    first, second = data["episodes"]
    assert (first["name"], second["name"]) == ("worst", "best")
    assert first["bodies"] == second["bodies"]
    # Both fingers are one mesh, and so are all of both episodes.
    assert sorted({*first["bodies"]}) == [*range(len(data["meshes"]))]
    for body, number in zip(film.bodies, first["bodies"], strict=False):
        mesh = data["meshes"][number]
        np.testing.assert_allclose(2e-5 * mesh["vertices"].T, body.vertices, atol=1.01e-5)
        np.testing.assert_array_equal(mesh["faces"].T, body.faces)
        assert (body.texels[:, 0] & 0xFC == mesh["texels"][:, :, 0].T).all()


def test_candidates_are_told_the_best_first(page):
    (told,) = read(page)["episodes"][0]["weighed"]
    assert (told["step"], told["measure"]) == (1, "a <chance>")
    assert [(c["kind"], c["value"], c["chosen"]) for c in told["candidates"]] == [
        ("grasp", 0.5, False), ("push", 0.25, True)
    ]  # fmt: skip
    assert told["candidates"][1]["way"] == [[0.1, 0.0, 0.02], [-0.1, 0.0, 0.02]]


def test_a_page_asks_nobody_and_names_cannot_break_it(film, page):
    assert "<title>a &amp; b</title>" in page
    assert "done <so>" not in page
    assert read(page)["episodes"][0]["words"] == "done <so>"
    # Nothing is loaded, and the browser is told to refuse it if it were.
    assert not re.search(r"(src|href)=(?!\"data:)|url\(|@import|https?://", page)
    assert "default-src 'none'" in page
    assert page == episode_page(
        "a & b", {"median": Shown(film, "done <so>", [None, weighed_of(page)])}
    )


def weighed_of(page):
    (told,) = read(page)["episodes"][0]["weighed"]
    grasp, push = (np.array(c["way"]) for c in told["candidates"])
    return Weighed((PUSH, GRASP), (push, grasp), np.array([0.25, 0.5]), 0, "a <chance>")


@pytest.fixture(scope="module")
def by_uncover():
    pytest.importorskip("torch")
    return evaluate_plan(EvaluationPlan("uncover", limit=2))


def test_a_shipped_policy_is_asked_again_what_it_weighed(by_uncover):
    models = object_set("household").models
    for one in by_uncover.episodes:
        found = weighed_again(by_uncover.header, one, models)
        assert len(found) == len(one.actions)
        decisions = [each for each in found if each]
        assert found[0] is decisions[0]
        assert all(len(each.values) == 96 for each in decisions)
        assert all(each.values[each.chosen] == each.values.max() for each in decisions)
        # It goes where the push begins that it chose: first over the heap, or straight there.
        chosen = found[0].ways[found[0].chosen]
        passed = np.linalg.norm(one.ee_positions - chosen[0], axis=1).min()
        assert passed < 0.05


def test_what_a_file_names_is_not_run_and_another_policy_has_weighed_nothing(by_uncover, tmp_path):
    from mechsearch.push_values.algorithm import PushValues
    from mechsearch.push_values.policy import PushPolicy, PushPolicyConfig
    from mechsearch.push_values.value import Continuation, PushValue, PushValueConfig
    from mechsearch.training.run_directory import save_policy, trained

    # It chooses pushes too, and others.
    other = PushPolicy([PushValue(PushValueConfig())], Continuation(), PushPolicyConfig(12))
    save_policy(trained(other, PushValues(), 0, TaskConfig()), tmp_path / "other.safetensors")
    models, one = object_set("household").models, by_uncover.episodes[0]
    foreign = {**by_uncover.header, "policy": "os:abort"}
    assert weighed_again(foreign, one, models) == []
    assert weighed_again(by_uncover.header, one, models, str(tmp_path / "other.safetensors")) == []
    assert len(weighed_again(foreign, one, models, "uncover")) == len(one.actions)


def test_show_writes_a_page_of_an_episode(by_uncover, tmp_path, capsys):
    save_episodes(tmp_path / "uncover.npz", by_uncover)
    main(
        [
            "show",
            str(tmp_path / "uncover.npz"),
            "--out",
            str(tmp_path / "a.html"),
            "--which",
            "best",
        ]
    )
    text = (tmp_path / "a.html").read_text(encoding="utf-8")
    (episode,) = read(text)["episodes"]
    best = max(by_uncover.episodes, key=lambda record: record.rewards.sum())
    assert episode["hidden"] == pytest.approx(best.occlusions.tolist(), abs=1e-4)
    assert episode["weighed"]
    assert len(text) < 2_000_000
    assert f"uncover on heap {best.heap_seed}: " in capsys.readouterr().out


def test_show_plays_a_submission_again(ycb_folder, tmp_path):
    path, root = tmp_path / "a.html", Path(__file__).parents[2] / "results"
    file = root / "benchmark" / "uncover" / "single" / "idle.npz"
    words = ["--heaps", str(root / "heaps"), "--objects", str(ycb_folder), "--which", "worst"]
    main(["show", str(file), "--out", str(path), *words])
    claims = load_submission(file).claims
    worst = min(claims, key=lambda claim: (claim.scores["reward"], claim.heap_seed))
    (episode,) = read(path.read_text(encoding="utf-8"))["episodes"]
    assert len(episode["tips"]) == len(worst.actions) + 1
    assert episode["reward"][-1] == pytest.approx(worst.scores["reward"], abs=1e-3)
