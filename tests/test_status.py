"""What `mechsearch status` says of a run that is at work, that was stopped, and that is over."""

import json

import pytest

import mechsearch
from mechsearch.cli import main
from mechsearch.files import PROGRESS_FILE
from mechsearch.training import run as training

HEAPS = "household-single"
STATE = json.dumps(
    {
        "label": "one, scoring", "done": 300, "total": 900, "time": 1100.0, "began": [1000.0, 100],
    }
)  # fmt: skip
"""What a run has told of itself: it began at 100 actions, 100 s before."""

OPTIONS = {"actions": 8, "evaluate_every": 4, "checkpoint_every": 2, "validation_heaps": 1}


def said(folder, capsys):
    capsys.readouterr()
    main(["status", str(folder)])
    return capsys.readouterr().out


def test_a_run_is_watched_from_outside_while_it_goes_on_stops_and_ends(
    tmp_path, capsys, monkeypatch
):
    pytest.importorskip("torch")
    monkeypatch.setattr(training, "_KEPT_EVERY", 0.0)
    told = {}

    def watch(label, done, total):
        told[done, label.rpartition(", ")[2]] = said(tmp_path / "run", capsys)
        if done == 6:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mechsearch.train("debug", HEAPS, tmp_path / "run", max_actions=3, progress=watch, **OPTIONS)
    # What is shown was told just before.
    assert "3 of 8 actions (38%); at work; " in told[4, "debug"]
    assert "actions a second" in told[4, "debug"]
    assert "4 of 8 actions (50%); at work, learning; " in told[4, "scoring"]
    assert "validation heaps  4 actions" in told[5, "uncovered 0%"]
    stopped = said(tmp_path / "run", capsys)
    assert "5 of 8 actions (62%); stopped; go on by `mechsearch train --resume " in stopped
    mechsearch.train("debug", HEAPS, tmp_path / "run", resume=True, max_actions=3, **OPTIONS)
    assert "debug, seed 0: 8 of 8 actions (100%); finished" in said(tmp_path / "run", capsys)


def test_time_left_is_what_remains_at_the_pace_so_far(tmp_path, capsys, monkeypatch):
    curve = mechsearch.CurveLogger(tmp_path / "run", "theirs", seed=3)
    curve.episode(1200, -8.0, 20)
    assert "theirs, seed 3: 1,200 actions" in said(tmp_path / "run", capsys)
    (tmp_path / "run" / PROGRESS_FILE).write_text(STATE)
    monkeypatch.setattr("time.time", lambda: 1110.0)
    with training.alone(tmp_path / "run" / "run", "the run"):
        found = said(tmp_path / "run", capsys)
    # Two a second: 300 seconds for the 600 that are left, of which ten have passed.
    assert "300 of 900 actions (33%); at work, scoring; 2 actions a second, 0:04:50 left" in found


def test_a_sweep_names_the_runs_that_are_at_work(tmp_path, capsys, monkeypatch):
    pytest.importorskip("torch")
    from mechsearch.experiments.folder import SweepFolder
    from mechsearch.experiments.plan import QUICK, open_plan
    from mechsearch.experiments.sweep import BEGAN, Journal
    from mechsearch.training.config import run_config, save_config

    folder = SweepFolder(tmp_path)
    open_plan(QUICK, folder)
    journal = Journal(folder.journal)
    journal.begin(2)
    journal.write(BEGAN, job="single/method-seed0")
    run = folder.run("single", "method-seed0")
    save_config(run_config("method"), run / "config.json")
    (run / PROGRESS_FILE).write_text(STATE)
    monkeypatch.setattr("time.time", lambda: 1110.0)
    with training.alone(folder.lock, "the sweep"), training.alone(run / "run", "the run"):
        main(["status", str(tmp_path)])
    last = capsys.readouterr().out.splitlines()[-1]
    assert "method, seed 0: 300 of 900 actions (33%); at work, scoring" in last
    assert last.endswith("2 actions a second, 0:04:50 left")
