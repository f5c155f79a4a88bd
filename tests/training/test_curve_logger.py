"""Curves of other people's learners stand in reports like our own."""

import numpy as np
import pytest

import mechsearch
from mechsearch.cli import main
from mechsearch.env import TaskConfig
from mechsearch.findings.experiment import read_run
from mechsearch.report.figures import draw_training
from mechsearch.types import MechSearchError

SMALL = TaskConfig(max_actions=3)


def waiting(obs):
    assert set(obs) == {"ee_position"}
    return np.zeros(3)


def test_three_lines_make_a_curve_and_a_row_in_the_report(tmp_path):
    curve = mechsearch.CurveLogger(tmp_path / "run", "waiting", seed=4, limit=2, task=SMALL)
    for step in (0, 50):
        scores = curve.evaluate(step, waiting, keys=("ee_position",))
        curve.episode(step + 3, reward=-1.5, actions=3)
    # Three actions of idleness, half a point each, in both heaps.
    assert [scores[f"reward{end}"] for end in ("", "_ci_low", "_ci_high")] == [-1.5] * 3
    assert scores["heaps"] == 2
    run = read_run(tmp_path / "run")
    assert run.series("held_out", "reward")[0].tolist() == [0, 50]
    assert run.series("episode", "return")[1].tolist() == [-1.5, -1.5]
    page = tmp_path / "report.html"
    main(["evaluate", "idle", "--limit", "2", "--workers", "1", "--max-actions", "3", "--out",
          str(tmp_path / "scores")])  # fmt: skip
    main(["report", str(tmp_path), "--out", str(page), "--no-pictures"])
    text = page.read_text()
    assert "waiting" in text
    assert "held-out heaps" in text
    titles = [ax.get_title(loc="left") for ax in draw_training(run).axes]
    assert titles == ["return of each episode", "actions of each episode"]


def test_a_second_run_in_the_same_place_is_refused(tmp_path):
    mechsearch.CurveLogger(tmp_path, "first")
    with pytest.raises(MechSearchError, match="holds a run already"):
        mechsearch.CurveLogger(tmp_path, "second")
