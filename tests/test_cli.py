import hashlib
import importlib
import importlib.util
import json
import os
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mechsearch.cli import COMMANDS, EXTRAS_OF, main
from mechsearch.cli.evaluation import file_name, named
from mechsearch.evaluation import episodes
from mechsearch.evaluation.episodes import METRICS, Evaluation
from mechsearch.files import alone, read_record, write_record
from mechsearch.types import EXTRAS, MechSearchError


def failure(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Return the one line that a command says before it exits with 2."""
    capsys.readouterr()
    with pytest.raises(SystemExit) as stopped:
        main(words)
    assert stopped.value.code == 2
    said = capsys.readouterr()
    assert "Traceback" not in said.err
    assert said.err.startswith("mechsearch: ")
    assert said.err.count("\n") == 1
    return said.err


@pytest.fixture(scope="module")
def heaps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("cli") / "heaps.parquet"
    options = ["--heaps", "4", "--counts", "4", "--workers", "1", "--seed", "3"]
    main(["heaps", "generate", "--out", str(path), *options])
    return path


@pytest.fixture(scope="module")
def scores(heaps: Path) -> Path:
    out = heaps.parent / "evaluations"
    words = ["evaluate", "idle", "random", "--heaps", str(heaps), "--out", str(out)]
    main([*words, "--workers", "1", "--summary", str(out / "summary.csv")])
    return out


def test_the_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--version"])
    assert capsys.readouterr().out == f"mechsearch {importlib.metadata.version('mechsearch')}\n"


@pytest.mark.parametrize("words", [[], ["--help"], ["-h"]])
def test_help_lists_every_command(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    main(words)
    said = capsys.readouterr().out
    assert all(f"  {name} " in said for name in COMMANDS)
    assert max(map(len, said.splitlines())) <= 100


def test_a_group_lists_its_own_commands(capsys: pytest.CaptureFixture[str]) -> None:
    main(["heaps"])
    said = capsys.readouterr().out
    assert "heaps verify" in said
    assert "evaluate" not in said


def test_python_can_run_the_package(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["mechsearch", "--version"])
    runpy.run_module("mechsearch", run_name="__main__")
    assert capsys.readouterr().out.startswith("mechsearch ")


def test_without_ray_its_options_say_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    words = ["heaps", "generate", "--out", str(tmp_path / "heaps.parquet")]
    assert "pip install '.[ray]'" in failure([*words, "--ray"], capsys)
    assert "pip install '.[ray]'" in failure([*words, "--ray-address", "auto"], capsys)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_explains_itself(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    for extra in EXTRAS_OF[name]:
        pytest.importorskip(EXTRAS[extra][1])
    with pytest.raises(SystemExit) as stopped:
        main([*name.split(), "--help"])
    assert stopped.value.code == 0
    assert f"mechsearch {name}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["bogus"], "unknown command 'bogus'; choose one of assets pull, objects list"),
        (["heaps", "bogus"], "unknown command 'heaps bogus'; choose one of heaps generate"),
        (["objects", "list", "--objects", "no/such"], "no/such"),
        (["heaps", "show", "absent.parquet"], "no heap set at absent.parquet"),
        (["evaluate", "idle", "--heaps", "absent.parquet"], "no heap set at absent.parquet"),
        (["evaluate", "nobody", "--heaps", "absent.parquet"], "unknown policy 'nobody'"),
        (["evaluate", "--heaps", "absent.parquet"], "0 policies given"),
        (["show", "absent.npz"], "no evaluation at absent.npz"),
        (["show", "absent.npz", "--out", "a.bmp"], "unknown format '.bmp'; choose one of .png"),
        (["show", "absent.npz", "--size", "100000"], "100000 px; expected 16 to 2048"),
        (["show", "absent.npz", "--out", "a.gif", "--rate", "nan"], "nan moments a second"),
        (["objects", "sheet", "--out", "sheet"], "sheet names no format; choose one of .png"),
        (["objects", "sheet", "--columns", "0"], "0 columns; expected at least 1"),
        (["heaps", "show", "absent.parquet", "--out", "a.tga"], "choose one of .png, .jpg"),
        (["report", "absent", "--out", "page"], "page names no format; choose one of .html"),
        (["report", "absent.csv", "--out", "a.png"], "unknown format '.png'; choose one of .svg"),
        (["heaps", "generate", "--out", "h.parquet", "--counts", "0"], "expected each at least 2"),
        (["heaps", "generate", "--out", "h.parquet", "--counts", "60", "--heaps", "2"], "need 60"),
        (["heaps", "verify", "absent.parquet", "--workers", "0"], "0 workers; expected at least 1"),
        (["evaluate", "json:dumps"], "policy 'json:dumps', called with no arguments, raised Type"),
        (["report", "absent"], "there is nothing at absent"),
        (["report", "absent.csv"], "no summary at absent.csv"),
        (["heaps", "generate", "--out", "h.parquet", "--condition", "triple"], "'triple'"),
        (["heaps", "generate", "--out", "h.parquet", "--heaps", "4"], "multiple of 3"),
    ],
)
def test_bad_input_is_answered_in_one_line(
    words: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert message in failure(words, capsys)
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_option_exits_with_2(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["objects", "list", "--colour", "red"])
    assert stopped.value.code == 2
    assert "--colour" in capsys.readouterr().err


@pytest.mark.parametrize("name", [name for name in COMMANDS if EXTRAS_OF[name]])
def test_a_command_without_what_it_needs_says_what_to_install(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    said = failure([*name.split(), "--help"], capsys)
    assert f"pip install '.[{EXTRAS_OF[name][0]}]'" in said


def test_an_interruption_says_that_files_are_whole(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(words: list[str]) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("mechsearch.cli.objects.load_object_set", interrupted)
    with pytest.raises(SystemExit) as stopped:
        main(["objects", "list"])
    assert stopped.value.code == 130
    assert "whole" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "left"),
    [
        (["heaps", "generate", "--out", "h p"], "go on by `mechsearch heaps generate --out 'h p'`"),
        (["train", "debug", "--heaps", "h", "--out", "r"], "nothing was learnt yet; give the same"),
        (["train", "--resume", "begun"], "40 actions, what came after is lost; go on by "
         "`mechsearch train --resume begun`"),
        (["grasp", "label", "--heaps", "h", "--out", "g"], "go on by `mechsearch grasp label"),
        (["grasp", "train", "--labels", "g", "--out", "n"], "go on by `mechsearch grasp train"),
        (["sweep", "--out", "s"], "go on by `mechsearch sweep --out s`"),
        (["evaluate", "idle", "random"], "go on by the same command with these policies alone: idle"
         " random"),
    ],
)  # fmt: skip
def test_an_interruption_says_how_to_go_on(
    words: list[str], left: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    pytest.importorskip("torch")

    def interrupted(*args: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.chdir(tmp_path)
    begun = tmp_path / "begun"
    config = importlib.import_module("mechsearch.training.config")
    config.save_config(config.run_config("debug"), begun / "config.json")
    record = {"heaps": "h", "heap_set": "", "objects": ""}
    write_record(begun / "inputs.json", "record of a run's inputs", record)
    (begun / "checkpoints").mkdir()
    for step in (20, 40):
        (begun / "checkpoints" / f"step-{step:08d}.safetensors").touch()
    for work in (
        "heaps.generate", "training.train", "grasp_learning.load_heaps", "sweeping.carry_out",
        "grasp_learning.load_grasps", "evaluation.evaluate_plan",
    ):  # fmt: skip
        module, _, name = work.partition(".")
        monkeypatch.setattr(importlib.import_module(f"mechsearch.cli.{module}"), name, interrupted)
    with pytest.raises(SystemExit) as stopped:
        main(words)
    said = capsys.readouterr().err
    assert stopped.value.code == 130
    assert said.count("\n") == 1
    assert left in said


def test_what_a_terminal_cannot_show_and_a_notebook_has_set_is_no_reason_to_stop() -> None:
    words = [sys.executable, "-m", "mechsearch", "report", "größe"]
    env = {**os.environ, "PYTHONIOENCODING": "ascii", "MPLBACKEND": "module://notebook"}
    done = subprocess.run(words, env=env, capture_output=True, text=True, check=False)
    assert done.stderr == "mechsearch: there is nothing at gr\\xf6\\xdfe\n"


def test_a_message_of_several_lines_becomes_one(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(words: list[str]) -> None:
        raise MechSearchError("first\n  second")

    monkeypatch.setattr("mechsearch.cli._dispatch", fail)
    assert failure([], capsys) == "mechsearch: first second\n"


def test_objects_are_listed_and_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["objects", "list"])
    assert "golf_ball" in capsys.readouterr().out
    main(["objects", "sheet", "--size", "32", "--out", str(tmp_path / "sheet.png")])
    with Image.open(tmp_path / "sheet.png") as sheet:
        assert sheet.width == 8 * 42 + 10


def test_heaps_are_described_drawn_and_verified(
    heaps: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["heaps", "show", str(heaps), "--out", str(tmp_path / "heaps.png")])
    said = capsys.readouterr().out
    assert "4 single heaps of household objects, seed 3" in said
    assert (tmp_path / "heaps.png").stat().st_size > 1000
    main(["heaps", "verify", str(heaps), "--workers", "1"])
    assert "4 of 4 heaps rest" in capsys.readouterr().out


def test_heaps_are_not_overwritten(heaps: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = heaps.read_bytes()
    words = ["heaps", "generate", "--out", str(heaps), "--heaps", "4", "--counts", "4"]
    assert "exists already" in failure([*words, "--workers", "1"], capsys)
    assert heaps.read_bytes() == before


def test_scores_are_recorded_and_entered_into_the_summary(scores: Path) -> None:
    for policy in ("idle", "random"):
        evaluation = episodes.load_episodes(scores / f"{policy}.npz")
        assert evaluation.header["name"] == policy
        assert len(evaluation.episodes) == 2
    rows = episodes.read_summary(scores / "summary.csv")
    assert len(rows) == 2 * len(METRICS)
    assert {(row.condition, row.actions, row.seed) for row in rows} == {("single", 0, 0)}


def test_an_evaluation_of_something_else_is_not_written_over(
    heaps: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, file = tmp_path / "scores", tmp_path / "scores" / "idle.npz"
    words = ["evaluate", "idle", "--heaps", str(heaps), "--out", str(out), "--workers", "1"]
    words += ["--max-actions", "2"]
    main([*words, "--limit", "1"])
    before = file.read_bytes()
    for others, said in (
        ([], "of another heaps; give it a --name of its own"),
        (["--limit", "1", "--seed", "1"], "of another seed;"),
        (["--limit", "1", "--max-actions", "3"], "of another env;"),
        (["--limit", "1", "--split", "train"], "of another split;"),
    ):
        assert said in failure([*words, *others], capsys)
        assert file.read_bytes() == before
    main([*words, "--limit", "1"])
    assert file.read_bytes() == before
    main([*words, "--name", "still"])
    assert len(episodes.load_episodes(out / "still.npz").episodes) == 2
    main([*words, "--overwrite"])
    assert len(episodes.load_episodes(file).episodes) == 2


def test_two_evaluations_at_once_do_not_share_a_folder(
    heaps: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with alone(tmp_path / "evaluations", "it"):
        words = ["evaluate", "idle", "--heaps", str(heaps), "--out", str(tmp_path)]
        assert "another process is at work in the evaluations in" in failure(words, capsys)


def test_help_is_short_and_tells_where_the_rest_is(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("torch")
    for words in (["train", "method"], ["train", "plus"], ["evaluate"], ["sweep"]):
        said = []
        for option in ("--help", "--help-all"):
            with pytest.raises(SystemExit) as stopped:
                main([*words, option])
            assert stopped.value.code == 0
            said.append(capsys.readouterr().out)
        assert len(said[0].splitlines()) < 80
        assert "--physics.time-step" not in said[0]
        assert f"{' '.join(words)} --help-all" in said[0]
        assert "--physics.time-step" in said[1]


def test_an_episode_is_shown_as_picture_and_film(
    scores: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["show", str(scores / "random.npz"), "--size", "64", "--out"]
    main([*words, str(tmp_path / "a.png"), "--which", "best"])
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.width == 2 * 64 + 6
    main([*words, str(tmp_path / "A.GIF"), "--camera", "tilted"])
    with Image.open(tmp_path / "A.GIF") as film:
        assert film.format == "GIF"
        assert film.n_frames > 5
    message = failure([*words, str(tmp_path / "b.png"), "--which", "7"], capsys)
    assert "choose one of worst, median, best, or a heap's seed" in message


def test_episodes_recorded_with_other_objects_are_not_drawn(
    scores: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    evaluation = episodes.load_episodes(scores / "idle.npz")
    name, *_ = evaluation.header["object_hashes"]
    header = {**evaluation.header, "object_hashes": {name: "0" * 64}}
    episodes.save_episodes(tmp_path / "idle.npz", Evaluation(header, evaluation.episodes))
    message = failure(["show", str(tmp_path / "idle.npz")], capsys)
    assert (
        f"1 of the 1 recorded objects are missing from or differ in 'household': {name}" in message
    )


def test_a_page_and_a_plot_are_made_from_files_alone(scores: Path, tmp_path: Path) -> None:
    main(["report", str(scores), "--out", str(tmp_path / "r.html"), "--title", "Two of them"])
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert "<h1>Two of them</h1>" in text
    assert "data:image/png" in text
    main(["report", str(scores / "summary.csv"), "--out", str(tmp_path / "s.svg")])
    assert "<svg" in (tmp_path / "s.svg").read_text()


def test_a_run_is_trained_continued_evaluated_and_packed(
    heaps: Path, scores: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("torch")
    run = tmp_path / "run"
    words = ["train", "debug", "--heaps", str(heaps), "--out", str(run), "--actions", "12"]
    words += ["--warmup", "8", "--validation-heaps", "1", "--evaluate-every", "12", "--seed", "5"]
    main(words)
    assert "holds a run already" in failure(words, capsys)
    capsys.readouterr()
    main(["train", "--resume", str(run), "--actions", "13"])
    assert "it went on with" not in capsys.readouterr().out
    kind = "record of a run's inputs"
    inputs = read_record(run / "inputs.json", kind)
    assert len(inputs["fingerprints"]) == 1
    inputs["fingerprints"][0]["torch"] = "2.0.0"
    write_record(run / "inputs.json", kind, inputs)
    main(["train", "--resume", str(run), "--actions", "14"])
    assert "instead of 2.0.0: not the bits of a run" in capsys.readouterr().out
    assert json.loads((run / "config.json").read_text())["schedule"]["actions"] == 14
    out = tmp_path / "evaluations"
    table = tmp_path / "summary.csv"
    words = ["evaluate", str(run), "--heaps", str(heaps), "--out", str(out), "--workers", "1"]
    main([*words, "--limit", "1", "--summary", str(table)])
    header = episodes.load_episodes(out / "debug-seed5-14.npz").header
    assert (header["trained"], header["training_actions"]) == (True, 14)
    assert {(row.variant, row.seed, row.actions) for row in episodes.read_summary(table)} == {
        ("debug", 5, 14)
    }
    main(["report", str(out), str(run), "--out", str(tmp_path / "r.html"), "--no-pictures"])
    assert "Evaluations during training" in (tmp_path / "r.html").read_text(encoding="utf-8")
    recorded, packed = out / "debug-seed5-14.npz", tmp_path / "mine" / "debug.safetensors"
    main(["pack", str(run), "--scores", str(recorded), "--out", str(packed)])
    card = json.loads(packed.with_suffix(".json").read_text())
    assert card["sha256"] == hashlib.sha256(packed.read_bytes()).hexdigest()
    assert (card["variant"], card["seed"], card["executed_actions"]) == ("debug", 5, 14)
    assert card["trained_on"]["heap_set"] == card["scored_on"]["heap_set"]
    rewards = [record.rewards.sum() for record in episodes.load_episodes(recorded).episodes]
    assert card["scores"]["reward"][0] == pytest.approx(np.mean(rewards))
    other = ["pack", str(run), "--scores", str(scores / "idle.npz"), "--out", str(packed)]
    said = failure(other, capsys)
    assert "are of another policy" in said
    assert "of 'idle' after 0 actions" in said


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["metod"], "unknown variant 'metod'; choose one of method, ddpg"),
        (["--resume"], "--resume needs a run directory"),
        (["--resume", "absent"], "no training configuration at"),
        (["debug", "--resume"], "mechsearch train --resume FOLDER"),
    ],
)
def test_training_that_cannot_begin_says_why(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("torch")
    assert message in failure(["train", *words], capsys)


def make(name: str, seed: int | None = None, actions: int = 0) -> Evaluation:
    trained = seed is not None
    header = {"name": name, "trained": trained, "training_seed": seed, "training_actions": actions}
    return Evaluation(header, ())


def test_names_tell_runs_apart_no_more_than_needed() -> None:
    found = [make("idle"), make("teacher-spiral"), make("ddpg", 0, 9), make("method", 0, 9)]
    assert list(named(found)) == ["method", "ddpg", "teacher-spiral", "idle"]
    seeds = [make("method", 1, 9), make("method", 0, 9)]
    assert set(named(seeds)) == {"method, seed 0", "method, seed 1"}
    lengths = [make("method", 0, 4000), make("method", 0, 8000)]
    assert list(named(lengths)) == [
        "method, seed 0, 4,000 actions",
        "method, seed 0, 8,000 actions",
    ]
    assert len(named([make("idle"), make("idle")])) == 2


def test_file_names_hold_nothing_strange() -> None:
    assert file_name(make("my.module:Policy")) == "my.module-Policy"
    assert file_name(make("method", 2, 8000)) == "method-seed2-8000"
