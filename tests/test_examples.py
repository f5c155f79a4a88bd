import subprocess
import sys
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

import mechsearch
from mechsearch.cli import main
from mechsearch.evaluation.episodes import load_episodes
from mechsearch.evaluation.frames import frames_of
from mechsearch.evaluation.rollout import EvaluationPlan
from mechsearch.pictures.live import LiveSession
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


def test_an_algorithm_of_80_lines_trains_resumes_is_evaluated_and_reported(tmp_path, monkeypatch):
    pytest.importorskip("torch")
    monkeypatch.syspath_prepend(FOLDER)
    assert len((FOLDER / "behaviour_cloning.py").read_text().splitlines()) <= 80
    heaps = str(resources.files("mechsearch.heaps") / "household_single.parquet")
    often = {"evaluate_every": 60, "checkpoint_every": 60, "validation_heaps": 2, "passes": 1}
    for out, actions in (("whole", 150), ("parts", 70), ("parts", 150)):
        mechsearch.train(
            "behaviour_cloning:Cloning", heaps, tmp_path / out, actions=actions,
            resume=(out, actions) == ("parts", 150), **often,
        )  # fmt: skip
    for name in ("metrics.jsonl", "actor.safetensors"):
        whole, parts = ((tmp_path / run / name).read_bytes() for run in ("whole", "parts"))
        assert whole == parts
    run, scores = tmp_path / "whole", tmp_path / "scores"
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
