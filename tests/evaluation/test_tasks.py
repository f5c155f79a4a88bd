"""Each evaluation is in the task of the policy's run, unless something else is said of it."""

import json
import sys
from dataclasses import asdict
from pathlib import Path

import pytest

import mechsearch
from mechsearch.cli import main
from mechsearch.cli.overrides import optional, overridden
from mechsearch.env.heap_env import TaskConfig
from mechsearch.env.reward import RewardConfig
from mechsearch.evaluation.episodes import load_episodes
from mechsearch.evaluation.policies import IdlePolicy, check_view, task_of
from mechsearch.evaluation.rollout import EvaluationPlan, in_task, record_differences
from mechsearch.heaps.dataset import embedded_file
from mechsearch.types import MechSearchError

TASK = TaskConfig("tilted", 48, max_actions=9, reward=RewardConfig(movement=100.0))
NEW = {"name": "method", "task": json.loads(json.dumps(asdict(TASK)))}
FLAT = {"name": "method", "camera": "tilted", "image_size": 48, "actions": 8000}


class Seeing(IdlePolicy):
    """Reads images."""

    keys = ("position_image",)


class Tilted(Seeing):
    """Says what it sees through."""

    camera = "tilted"


class Bound(Tilted):
    """Says how large its images are too, as trained policies do."""

    image_size = 48


def test_the_task_is_that_of_the_run_in_any_versions_layout():
    assert task_of(Seeing(), NEW, "overhead") == TASK
    assert task_of(Seeing(), FLAT, "overhead") == TaskConfig("tilted", 48)
    assert task_of(IdlePolicy(), {}, "tilted") == TaskConfig("tilted")
    assert task_of(Tilted(), {}, "overhead") == TaskConfig("tilted")
    assert task_of(Bound(), {}, "overhead") == TaskConfig("tilted", 48)


def test_the_shipped_policies_have_a_task():
    pytest.importorskip("torch")
    assert in_task(EvaluationPlan("uncover"), lambda own: own).task == TaskConfig()


@pytest.mark.parametrize(("policy", "run"), [(Seeing(), NEW), (Seeing(), FLAT), (Bound(), {})])
def test_who_sees_through_one_camera_is_not_shown_another(policy, run):
    check_view(policy, run, TASK, "it")
    for task in (TaskConfig("tilted"), TaskConfig("overhead", 48)):
        message = (
            "it sees through the tilted camera at 48 px; the task has the "
            f"{task.camera} camera at {task.image_size} px"
        )
        with pytest.raises(MechSearchError, match=message):
            check_view(policy, run, task, "it")


def test_who_says_only_the_camera_sees_images_of_any_size():
    check_view(Tilted(), {}, TASK, "it")
    with pytest.raises(MechSearchError, match="it sees through the tilted camera"):
        check_view(Tilted(), {}, TaskConfig(), "it")


def test_who_reads_no_images_or_says_nothing_acts_under_any_camera():
    check_view(IdlePolicy(), FLAT, TaskConfig(), "it")
    check_view(Seeing(), {}, TASK, "it")


@pytest.mark.parametrize("words", [["--camera", "tilted"], ["--image-size", "48"]])
def test_the_command_refuses_what_a_shipped_policy_cannot_see(words, tmp_path, capsys):
    pytest.importorskip("torch")
    with pytest.raises(SystemExit):
        main(["evaluate", "idle", "uncover", "--out", str(tmp_path), *words])
    assert "uncover sees through the overhead camera at 64 px" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_only_what_is_said_is_changed():
    said = optional(TaskConfig)
    assert overridden(TASK, said()) == TASK
    changed = overridden(TASK, said(max_actions=3, reward=optional(RewardConfig)(idleness=0.0)))
    assert changed == TaskConfig(
        "tilted", 48, max_actions=3, reward=RewardConfig(movement=100.0, idleness=0.0)
    )
    assert said.__doc__ == TaskConfig.__doc__


def test_what_is_said_is_named_and_python_gives_the_commands_bits(tmp_path: Path, capsys):
    words = ["--out", str(tmp_path), "--limit", "1", "--workers", "1", "--seed", "3"]
    words += ["--reward.movement", "100", "--max-actions", "4", "--camera", "tilted"]
    main(["evaluate", "random", "--brief", *words])
    told = ("camera overhead -> tilted", "max_actions 50 -> 4", "reward.movement 75 -> 100")
    assert f"random, in another task: {', '.join(told)}" in capsys.readouterr().out
    recorded = load_episodes(tmp_path / "random.npz")
    assert recorded.header["task_differs"] == list(told)
    assert recorded.header["env"]["reward"]["movement"] == 100
    task = TaskConfig("tilted", max_actions=4, reward=RewardConfig(movement=100.0))
    found = mechsearch.evaluate("random", limit=1, seed=3, task=task)
    assert found.header == recorded.header
    assert record_differences(recorded.episodes[0], found.episodes[0]) == ()


def test_a_policy_of_ones_own_is_evaluated_as_it_is():
    task = TaskConfig(max_actions=2)
    found = mechsearch.evaluate(Seeing(), limit=2, task=task)
    header = found.header
    assert (header["name"], header["policy"], header["trained"]) == ("Seeing", "Seeing", False)
    assert header["task_differs"] == ["max_actions 50 -> 2"]
    assert [len(record.actions) for record in found.episodes] == [2, 2]
    with pytest.raises(MechSearchError, match="gives a int without keys, reset, act"):
        mechsearch.evaluate(3)


def test_a_policy_that_cannot_travel_needs_this_process():
    class Local(IdlePolicy):
        """Cannot be imported elsewhere."""

    with pytest.raises(MechSearchError, match=r"Local cannot be handed .*; expected workers=1"):
        mechsearch.evaluate(Local(), limit=2, workers=2)


def test_rewards_of_ones_own_are_recorded_and_verified(tmp_path: Path, monkeypatch, capsys):
    (tmp_path / "sparse_reward.py").write_text(
        "def sparse(before, after, *others): return {'gain': before - after}\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    words = ["--reward.function", "sparse_reward:sparse", "--max-actions", "5", "--workers", "1"]
    main(["evaluate", "teacher-spiral", "--limit", "1", "--out", str(tmp_path / "scores"), *words])
    assert "gain" in capsys.readouterr().out
    recorded = str(tmp_path / "scores" / "teacher-spiral.npz")
    main(["verify", recorded, "--heaps", str(embedded_file("single")), "--workers", "1"])
    assert "1 of 1 episodes are as recorded, bit by bit" in capsys.readouterr().out
    sys.modules.pop("sparse_reward")
