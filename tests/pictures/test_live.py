"""A live session without a browser: what is asked for, and what comes of it."""

import json
import threading
import urllib.error
import urllib.request

import numpy as np
import pytest

from mechsearch.cli import main
from mechsearch.evaluation.episodes import load_episodes
from mechsearch.evaluation.rollout import EvaluationPlan, opened, run_episode
from mechsearch.pictures.live import LiveSession, server
from mechsearch.types import MechSearchError
from tests.pictures.test_page import poses_of, read


def asked(session, **request):
    """Return what came of a request, read like a page."""
    return read(
        f'<script type="application/json">{session.answer(json.dumps(request).encode())}</script>'
    )


@pytest.fixture
def session(tmp_path):
    return LiveSession(EvaluationPlan("teacher-straight", limit=3), tmp_path / "kept")


def test_a_policy_that_is_watched_does_what_it_does_alone(session, tmp_path):
    plan = EvaluationPlan("teacher-straight", limit=3)
    policy, env, indices = opened(plan)
    alone = run_episode(policy, env, indices[1], name="teacher-straight")
    told = asked(session, do="open", heap=indices[1])
    poses, moments = poses_of(told["episodes"][0]), []
    assert [value for value, _ in told["state"]["heaps"]] == indices
    while not told["state"]["over"]:
        told = asked(session, do="step")
        moments += told["more"]["moments"]
        poses = np.concatenate([poses, poses_of(told["more"])])
    objects = alone.poses.shape[1]
    assert np.abs(poses[:, :objects, :3] - alone.poses[..., :3]).max() <= 2.6e-5
    assert moments[-1]["words"].endswith(alone.end)
    said = asked(session, do="save")["said"]
    (kept,) = load_episodes(said.removeprefix("wrote ")).episodes
    assert (kept.policy, kept.end) == ("teacher-straight", alone.end)
    np.testing.assert_array_equal(kept.poses, alone.poses)


def test_what_was_pushed_by_hand_is_kept_as_an_episode_that_can_be_verified(
    session, tmp_path, capsys
):
    start = asked(session, do="open")["episodes"][0]["tips"][0]
    told = asked(session, do="push", way=[0, 0, -1])
    assert told["more"]["tips"][-1][2] == pytest.approx(start[2] - 0.05, abs=2e-3)
    assert told["more"]["weighed"] == [{"step": 0, "measure": "", "candidates": []}]
    told = asked(session, do="go", to=[0.25, 0.25, 0.2])
    assert np.linalg.norm(np.subtract(told["more"]["tips"][-1], [0.25, 0.25, 0.2])) < 0.012
    assert "goes on after" in asked(session, do="save")["error"]
    assert asked(session, do="wait")["state"]["over"]
    asked(session, do="save")
    said = asked(session, do="save")["said"]
    assert said.endswith("-2.npz")
    evaluation = load_episodes(said.removeprefix("wrote "))
    assert evaluation.header["policy"] == evaluation.episodes[0].policy == "hand"
    main(["verify", said.removeprefix("wrote "), "--heaps", "household-single", "--workers", "1"])
    assert "1 of 1 episodes are as recorded" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("request_", "said"),
    [
        (b"[", "no JSON object"),
        (b'{"do": "fly"}', "unknown request 'fly'; choose one of open, step"),
        (b'{"do": "go", "to": [0, "a", 1]}', "to is [0, 'a', 1]; expected three numbers"),
        (b'{"do": "push", "way": [0, 1e999, 1]}', "expected three numbers"),
        (b'{"do": "open", "heap": 2}', "heap 2 is none of these; choose one of"),
        (b'{"do": "open", "policy": "genius"}', "unknown policy 'genius'"),
    ],
)
def test_a_request_that_cannot_be_met_changes_nothing(session, request_, said):
    before = asked(session, do="open")
    assert said in json.loads(session.answer(request_))["data"]["error"]
    after = asked(session, do="step")
    assert after["state"]["heap"] == before["state"]["heap"]
    assert len(after["more"]["tips"]) == 2


def test_the_server_answers_its_own_page_alone_and_a_taken_port_is_one_line(session):
    with server(session, "127.0.0.1", 0) as listening:
        threading.Thread(target=listening.serve_forever, daemon=True).start()
        place = f"http://127.0.0.1:{listening.server_port}"
        page = urllib.request.urlopen(place + "/").read().decode()
        assert '<script type="application/json" id="data">null</script>' in page

        def post(path, kind, body=b'{"do": "step"}'):
            sent = urllib.request.Request(place + path, body, {"Content-Type": kind})
            return json.load(urllib.request.urlopen(sent))

        assert len(post("/do", "application/json")["data"]["more"]["tips"]) == 2
        for path, kind in (("/do", "text/plain"), ("/else", "application/json")):
            with pytest.raises(urllib.error.HTTPError, match="400"):
                post(path, kind)
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(place + "/etc/passwd")
        with pytest.raises(MechSearchError, match="choose another --port, 0 takes a free one"):
            server(session, "127.0.0.1", listening.server_port)
        listening.shutdown()
    with pytest.raises(MechSearchError, match="nobody can listen at nowhere, port 99999"):
        server(session, "nowhere", 99999)
