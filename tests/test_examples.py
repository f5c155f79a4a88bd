import subprocess
import sys
from importlib import resources
from pathlib import Path

import pytest

import mechsearch
from mechsearch.cli import main
from mechsearch.evaluation.episodes import load_episodes
from mechsearch.training.run_directory import load_policy

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
