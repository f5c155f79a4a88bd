"""Data sets for other libraries; `make test-exports` has those libraries open them too."""

import io
import json
import os
import subprocess
from pathlib import Path

import gymnasium
import numpy as np
import pyarrow.parquet as pq
import pytest
from gymnasium.envs.registration import EnvSpec
from PIL import Image

import mechsearch
from mechsearch.cli import main
from mechsearch.env import RetrieveConfig, TaskConfig
from mechsearch.evaluation.episodes import load_episodes, save_episodes
from mechsearch.evaluation.frames import frames_of
from tests.evaluation.scripted import Scripted

HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Files of two short episodes each, that uncover and that retrieve, and their frames."""
    place = tmp_path_factory.mktemp("recorded")
    small = {"max_actions": 4, "image_size": 16}
    made = {
        "uncover": mechsearch.evaluate("teacher-spiral", limit=2, task=TaskConfig(**small)),
        "retrieve": mechsearch.evaluate(
            Scripted(), limit=2, task=RetrieveConfig(**small, max_grasps=1)
        ),
    }
    found = {}
    for name, evaluation in made.items():
        save_episodes(place / f"{name}.npz", evaluation)
        frames = list(frames_of(load_episodes(place / f"{name}.npz")))
        found[name] = place / f"{name}.npz", frames
    return found


@pytest.fixture(scope="module", params=["uncover", "retrieve"])
def exported(request, recorded, tmp_path_factory):
    """The frames, and the folder of each format that was made of their file."""
    place = tmp_path_factory.mktemp("exported")
    file, frames = recorded[request.param]
    folders = {name: place / f"{request.param}-{name}-v3" for name in ("lerobot", "minari")}
    for name, folder in folders.items():
        main(["export", "episodes", str(file), "--format", name, "--out", str(folder),
              "--workers", "1"])  # fmt: skip
    return frames, folders


def as_lerobot(frames):
    """Return what LeRobot should have of each action, by feature."""
    found = {
        "observation.images.rgb": [f.observations["rgb"][:-1] for f in frames],
        "observation.images.depth": [
            f.observations["depth"][:-1].astype(np.float32) for f in frames
        ],
        "observation.position_image": [
            f.observations["position_image"][:-1].astype(np.float32) for f in frames
        ],
        "observation.state": [f.observations["ee_position"][:-1] for f in frames],
        "observation.occlusion": [f.record.occlusions[:-1] for f in frames],
        "action": [f.record.actions for f in frames],
        "next.reward": [f.record.rewards for f in frames],
        "next.reward_terms": [np.stack([*f.record.reward_terms.values()], 1) for f in frames],
        "next.occlusion": [f.record.occlusions[1:] for f in frames],
        "next.done": [ends(f) for f in frames],
        "next.success": [ends(f) & f.success for f in frames],
        "task": [np.repeat(f.task, len(f.record.actions)) for f in frames],
        "frame_index": [np.arange(len(f.record.actions)) for f in frames],
        "episode_index": [np.full(len(f.record.actions), i) for i, f in enumerate(frames)],
    }
    for key in frames[0].observations:
        if key in ("grasp_depth", "segments"):
            images = [f.observations[key][:-1, None] for f in frames]
            found[f"observation.images.{key}"] = images
        elif key.endswith("_left"):
            found[f"observation.{key}"] = [f.observations[key][:-1] for f in frames]
    whole = {name: np.concatenate(parts) for name, parts in found.items()}
    image = whole["observation.position_image"]
    whole["observation.images.target_mask"] = np.uint8(255) * (image != 0).any(1, keepdims=True)
    whole["index"] = np.arange(len(image))
    whole["task_index"] = np.unique(whole["task"], return_inverse=True)[1]
    if whole["task_index"][0]:
        whole["task_index"] = 1 - whole["task_index"]
    # An action of 30 steps of 5 ms: seven a second.
    whole["timestamp"] = whole["frame_index"].astype(np.float32) / np.float32(7)
    return whole


def as_minari(frames):
    """Return what Minari should have, by episode and name."""
    found = {}
    for i, shown in enumerate(frames):
        record, last = shown.record, ends(shown)
        over = shown.record.end in ("uncovered", "retrieved", "lost")
        own = {
            **{f"observations/{key}": value for key, value in shown.observations.items()},
            **{f"infos/term_{name}": after(v) for name, v in record.reward_terms.items()},
            "infos/occlusion": record.occlusions,
            "infos/success": after(last & shown.success),
            "actions": record.actions,
            "rewards": record.rewards,
            "terminations": last & over,
            "truncations": last & (not over),
        }
        if record.retrieval:
            own["infos/outcome"] = np.array(["", *record.retrieval.outcomes])
        found |= {f"{i}/{name}": value for name, value in own.items()}
    return found


def ends(shown):
    return np.arange(len(shown.record.actions)) == len(shown.record.actions) - 1


def after(values):
    return np.concatenate([np.zeros_like(values[:1]), values])


def test_frames_are_what_the_environment_shows(recorded):
    frames = recorded["uncover"][1]
    env = mechsearch.make_env(
        split="held-out", max_actions=4, image_size=16, keys=("rgb", "depth", "position_image")
    )
    for shown in frames:
        index = [heap.seed for heap in env.heaps].index(shown.record.heap_seed)
        seen = [env.reset(options={"heap": index, "fixed_start": True})[0]]
        seen += [env.step(action)[0] for action in shown.record.actions]
        for key in ("rgb", "depth", "position_image"):
            np.testing.assert_array_equal(
                shown.observations[key], np.stack([obs[key] for obs in seen])
            )
        assert shown.task.startswith("uncover the ")
        assert shown.task.endswith(shown.record.objects[shown.record.target].split("_")[-1])


def test_lerobots_files_hold_every_bit(exported):
    frames, folders = exported
    table = pq.read_table(folders["lerobot"] / "data")
    features = json.loads((folders["lerobot"] / "meta" / "info.json").read_text())["features"]
    expected = as_lerobot(frames)
    assert set(features) == set(expected) - {"task"} == set(table.column_names)
    for name, values in expected.items():
        if name == "task":
            continue
        rows = table[name].to_pylist()
        if features[name]["dtype"] == "image":
            rows = [np.array(Image.open(io.BytesIO(row["bytes"]))) for row in rows]
            rows = [row[None] if row.ndim == 2 else row.transpose(2, 0, 1) for row in rows]
        found = np.array(rows, values.dtype).reshape(values.shape)
        np.testing.assert_array_equal(found, values, err_msg=name)


def test_statistics_are_those_of_all_rows(exported):
    frames, folders = exported
    stats = json.loads((folders["lerobot"] / "meta" / "stats.json").read_text())
    expected = as_lerobot(frames)
    action = expected["action"].astype(float)
    for name, value in (("mean", action.mean(0)), ("std", action.std(0)), ("min", action.min(0))):
        np.testing.assert_allclose(stats["action"][name], value, atol=1e-9)
    colour = expected["observation.images.rgb"] / 255
    found = stats["observation.images.rgb"]
    np.testing.assert_allclose(np.ravel(found["mean"]), colour.mean((0, 2, 3)))
    np.testing.assert_allclose(np.ravel(found["std"]), colour.std((0, 2, 3)))
    assert np.shape(found["q99"]) == (3, 1, 1)


def test_minaris_environment_is_made_again(exported):
    frames, folders = exported
    about = json.loads((folders["minari"] / "data" / "metadata.json").read_text())
    env = gymnasium.make(EnvSpec.from_json(about["env_spec"]))
    assert about["dataset_id"] == folders["minari"].name
    assert env.observation_space["depth"].shape == frames[0].observations["depth"].shape[1:]


@pytest.mark.parametrize("library", ["lerobot", "minari"])
def test_the_library_itself_opens_it_and_nothing_is_lost(library, exported, tmp_path):
    python = os.environ.get(f"MECHSEARCH_{library.upper()}")
    if not python:
        pytest.skip(f"no {library} here: `make test-exports` installs it")
    frames, folders = exported
    np.savez(
        tmp_path / "expected.npz", **{"lerobot": as_lerobot, "minari": as_minari}[library](frames)
    )
    words = [python, str(HERE / f"open_{library}.py"), str(folders[library])]
    done = subprocess.run(
        [*words, str(tmp_path / "expected.npz")],
        capture_output=True, text=True, check=False, env={**os.environ, "PYTHONPATH": ""},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert f"{len(frames)} episodes" in done.stdout


def test_a_policy_is_rolled_out(tmp_path):
    out = tmp_path / "idle"
    main(["export", "episodes", "idle", "--limit", "1", "--workers", "1", "--format", "minari",
          "--out", str(out)])  # fmt: skip
    about = json.loads((out / "data" / "metadata.json").read_text())
    assert about["total_episodes"] == 1
    assert about["algorithm_name"] == "idle"
    assert about["dataset_id"] == "idle-v0"


def test_bad_input_is_refused_before_work(recorded, tmp_path, capsys):
    file = str(recorded["uncover"][0])
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "of.txt").write_text("something else")
    (tmp_path / "none.npz").write_text("no episodes")
    tries = {
        (file, "full"): "full is there already; name a new folder, or remove it first",
        (str(tmp_path / "none.npz"), "new"): "none.npz is damaged or no evaluation",
        ("teacher-loop", "new"): "teacher-loop",
    }
    for (source, out), expected in tries.items():
        with pytest.raises(SystemExit) as end:
            main(
                ["export", "episodes", source, "--format", "lerobot", "--out", str(tmp_path / out)]
            )
        assert end.value.code == 2
        said = capsys.readouterr().err.splitlines()[-1]
        assert expected in said
    assert not (tmp_path / "new").exists()


def test_what_takes_another_course_here_is_left_out_and_said(recorded, tmp_path, capsys):
    evaluation = load_episodes(recorded["uncover"][0])
    evaluation.episodes[0].poses[-1, 0, 0] += 0.01
    save_episodes(tmp_path / "moved.npz", evaluation)
    main(["export", "episodes", str(tmp_path / "moved.npz"), "--format", "lerobot",
          "--workers", "1", "--out", str(tmp_path / "one")])  # fmt: skip
    said = capsys.readouterr().out
    assert f"heap {evaluation.episodes[0].heap_seed} is left out: here its physics" in said
    assert "1 episodes" in said
    evaluation.episodes[1].poses[-1, 0, 0] += 0.01
    save_episodes(tmp_path / "moved.npz", evaluation)
    with pytest.raises(SystemExit):
        main(["export", "episodes", str(tmp_path / "moved.npz"), "--format", "lerobot",
              "--workers", "1", "--out", str(tmp_path / "none")])  # fmt: skip
    assert not (tmp_path / "none").exists()
