import importlib
import json
import subprocess
import sys
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

import mechsearch
from mechsearch.algorithm import RunConfig, Schedule
from mechsearch.cli import main
from mechsearch.evaluation.episodes import load_episodes
from mechsearch.evaluation.frames import frames_of
from mechsearch.evaluation.rollout import EvaluationPlan
from mechsearch.heaps.dataset import embedded_file, open_heaps
from mechsearch.pictures.live import LiveSession
from mechsearch.training.assemble import assemble
from mechsearch.training.run_directory import load_policy
from mechsearch.types import MechSearchError

FOLDER = Path(__file__).parents[1] / "examples"
EXAMPLES = sorted(FOLDER.glob("0*.py"))


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_every_example_runs_and_says_something(example, tmp_path):
    done = subprocess.run(
        [sys.executable, str(example)], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout


def trained_twice(algorithm, tmp_path, **options):
    """Return a run, which came out the same in one go and in two."""
    heaps = str(resources.files("mechsearch.heaps") / "household_single.parquet")
    often = {"evaluate_every": 60, "checkpoint_every": 60, "validation_heaps": 2}
    for out, actions in (("whole", 150), ("parts", 70), ("parts", 150)):
        mechsearch.train(
            algorithm, heaps, tmp_path / out, actions=actions,
            resume=(out, actions) == ("parts", 150), **often, **options,
        )  # fmt: skip
    for name in ("metrics.jsonl", "actor.safetensors"):
        whole, parts = ((tmp_path / run / name).read_bytes() for run in ("whole", "parts"))
        assert whole == parts
    return tmp_path / "whole"


def test_an_algorithm_of_80_lines_trains_resumes_is_evaluated_and_reported(tmp_path, monkeypatch):
    pytest.importorskip("torch")
    monkeypatch.syspath_prepend(FOLDER)
    assert len((FOLDER / "behaviour_cloning.py").read_text().splitlines()) <= 80
    run = trained_twice("behaviour_cloning:Cloning", tmp_path, passes=1)
    scores = tmp_path / "scores"
    main(["evaluate", str(run), "--limit", "2", "--workers", "1", "--out", str(scores)])
    evaluation = load_episodes(scores / f"Cloning-seed0-{load_policy(run).training_actions}.npz")
    assert evaluation.header["trained"]
    page = tmp_path / "report.html"
    main(["report", str(scores), str(run), "--out", str(page), "--no-pictures"])
    assert "Cloning" in page.read_text()


def test_pushes_of_a_person_are_learnt_from(tmp_path, monkeypatch):
    safetensors = pytest.importorskip("safetensors.numpy")
    monkeypatch.syspath_prepend(FOLDER)
    heaps = str(resources.files("mechsearch.heaps") / "household_single.parquet")
    live = LiveSession(EvaluationPlan("idle", limit=1, split="train"), tmp_path)
    live.answer(b'{"do": "push", "way": [0, 0, -1]}')
    live.answer(b'{"do": "wait"}')
    live.answer(b'{"do": "save"}')
    (file,) = tmp_path.glob("hand-*.npz")
    how = {"evaluate_every": 50, "validation_heaps": 1, "passes": 1, "actions": 50}
    imitation, run = "demonstrations:Imitation", tmp_path / "run"
    mechsearch.train(imitation, heaps, run, episodes=(str(file),), **how)
    (checkpoint,) = (run / "checkpoints").iterdir()
    tensors = safetensors.load_file(checkpoint)
    (shown,) = frames_of(load_episodes(file))
    assert len(shown.record.actions) == 50
    np.testing.assert_array_equal(tensors["seen/action"], shown.record.actions)
    np.testing.assert_array_equal(tensors["seen/depth"], shown.observations["depth"][:-1])
    assert '"policy": "hand"' in (run / "metrics.jsonl").read_text()
    with pytest.raises(MechSearchError, match="nothing to imitate"):
        mechsearch.train(imitation, heaps, tmp_path / "none", **how)


@pytest.fixture
def climbing(monkeypatch):
    """A session of moves in which one episode of a teacher was stored, and its algorithm."""
    torch = pytest.importorskip("torch")
    monkeypatch.syspath_prepend(FOLDER)
    module = importlib.import_module("asymmetric_sac")
    heaps, objects = open_heaps(embedded_file("single"))
    run = RunConfig("moves", module.AsymmetricSac(), schedule=Schedule(validation_heaps=0))
    session = run.algorithm.begin(run, assemble(run, heaps, objects), None)
    before = torch.get_rng_state()
    list(session.advance(1))
    yield module, session
    torch.set_rng_state(before)


def test_moves_are_learnt_go_on_where_they_stopped_and_score(tmp_path, monkeypatch):
    pytest.importorskip("torch")
    monkeypatch.syspath_prepend(FOLDER)
    how = {"warmup": 30, "taught": 60, "batch": 8, "updates": 1}
    run = trained_twice("asymmetric_sac:AsymmetricSac", tmp_path, **how)
    who = {json.loads(line).get("who") for line in (run / "metrics.jsonl").open()}
    assert who >= {"teacher", "actor"} or who >= {"teacher", "privileged"}
    with pytest.raises(MechSearchError, match="image_size 32"):
        mechsearch.train("asymmetric_sac:AsymmetricSac", None, tmp_path / "x", image_size=32)


def test_what_a_move_brought_is_what_its_nudges_brought(climbing):
    _, session = climbing
    kept, last = session.rows, session.used - 1
    ahead = kept["ahead"][: session.used]
    assert ahead[last] == 0
    assert {4} <= set(ahead[:last]) <= {1, 2, 3, 4}
    action, reward, discount, ends = session._moves(np.arange(last))
    for row, end in enumerate(ends):
        passed, bent = kept["ee_position"][row : end + 1], 1.1
        way = np.linalg.norm(np.diff(passed, axis=0), axis=1).sum()
        assert way <= bent * np.linalg.norm(passed[-1] - passed[0]) + 1e-3 or end == row + 1
        told = 0.1 * sum(0.97**i * r for i, r in enumerate(kept["reward"][row:end]))
        assert reward[row] == pytest.approx(told, rel=1e-5)
        follows = 0.97 ** (end - row) * kept["going"][row:end].prod()
        assert discount[row] == pytest.approx(follows, rel=1e-5)
        if end > row + 1:
            np.testing.assert_allclose(0.2 * action[row], passed[-1] - passed[0], atol=1e-6)


def test_a_move_goes_straight_to_a_place_in_the_bounds_by_nudges_of_5_cm(climbing):
    module, session = climbing
    ee = np.array([0.25, 0.0, 0.1])
    move, way = module.Move(ee, np.array([1.0, 0.0, -1.0]), 0.2, session.bounds), []
    while not move.done(ee):
        action = move.nudge(ee)
        assert np.linalg.norm(action) <= 1 + 1e-6
        way.append(action)
        ee = ee + 0.05 * action
    # Two nudges of the 10.3 cm; what is less than 4 mm away is reached.
    assert np.linalg.norm(ee - [0.3, 0.0, 0.01]) == pytest.approx(np.hypot(0.05, 0.09) - 0.1)
    assert len(way) == 2
    np.testing.assert_allclose(way[0], way[1], atol=1e-6)


def test_neither_critic_nor_its_actor_cares_about_the_order_of_the_objects(climbing):
    module, session = climbing
    rows = np.arange(session.used - 1)
    state, (action, *_) = session._states(rows), session._moves(rows)
    there = state["clutter_mask"][0].bool().numpy()
    order = np.arange(len(there))
    order[there] = order[there][::-1]
    keys = ("clutter_offsets", "clutter_mask", "radii")
    other = state | {key: state[key][:, order] for key in keys}
    critic, privileged = session.nets["critic"], session.nets["privileged"]
    move = module.torch.as_tensor(action)
    for ours, theirs in (
        (critic(state, move), critic(other, move)),
        (privileged(state)[0], privileged(other)[0]),
    ):
        np.testing.assert_allclose(ours.detach(), theirs.detach(), atol=1e-6)
    # What lies elsewhere is another state.
    apart = state | {"clutter_offsets": state["clutter_offsets"] + 0.05}
    assert (critic(state, move) - critic(apart, move)).abs().max() > 1e-5
