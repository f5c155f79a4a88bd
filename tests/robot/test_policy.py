"""Exported policies: the same as in PyTorch, or refused."""

import json
import shutil
import subprocess
import sys

import numpy as np
import pytest

from mechsearch.pushes.push import draw_pushes
from mechsearch.robot.policy import open_policy
from mechsearch.types import MechSearchError
from tests.robot.described import check_described


def test_exported_pushes_are_chosen_and_judged_as_in_pytorch(pushes, exported_pushes, observations):
    carried = open_policy(exported_pushes)
    hidden = {**observations[0], "position_image": np.zeros((3, 64, 64), np.float16)}
    for i, obs in enumerate([*observations, hidden]):
        pushes.reset(np.random.default_rng(i))
        carried.reset(np.random.default_rng(i))
        sight, candidates = pushes.see(obs), draw_pushes(24, np.random.default_rng(i))
        expected, found = pushes.judge(candidates, sight), carried.judge(candidates, sight)
        np.testing.assert_allclose(found, expected, atol=1e-4)
        assert found.argmax() == expected.argmax()
        # From the beginning of a push to its third action.
        for words in ("begins", "goes on", "goes on"):
            choice = carried.choose(obs)
            np.testing.assert_array_equal(choice.action, pushes.act(obs))
            assert words in choice.reason


def test_what_is_expected_is_the_mean_of_the_networks(pushes, exported_pushes, observations):
    import torch

    from mechsearch.pushes.push import view_pushes

    obs, carried = observations[0], open_policy(exported_pushes)
    carried.reset(np.random.default_rng(3))
    choice = carried.choose(obs)
    candidates = draw_pushes(24, np.random.default_rng(3), pushes.full_steps)
    views = view_pushes(candidates, pushes.see(obs))
    best = int(pushes.judge(candidates, pushes.see(obs)).argmax())
    with torch.inference_mode():
        out = torch.stack([
            n(torch.from_numpy(views.patches), torch.from_numpy(views.numbers))[best]
            for n in pushes.networks
        ]).numpy()  # fmt: skip
    uncovered = 1 / (1 + np.exp(-out[:, 1]))
    found = choice.expects
    assert found.uncovered == pytest.approx(uncovered.mean(), abs=1e-5)
    assert found.occlusion == pytest.approx(out[:, 2].mean(), abs=1e-5)
    assert found.actions == pytest.approx(views.actions[best] + 5 * out[:, 3].mean(), abs=1e-4)
    assert choice.confidence == pytest.approx(1 - abs(uncovered[0] - uncovered[1]), abs=1e-5)


def test_fewer_candidates_are_the_first_ones(
    pushes, exported_pushes, exported_actor, observations, tmp_path, capsys
):
    from mechsearch.cli import main

    words = ["export", "policy", str(exported_pushes.parent / "policy.safetensors"), "--out"]
    main([*words, str(tmp_path / "few"), "--candidates", "5"])
    carried = open_policy(tmp_path / "few")
    for i, obs in enumerate(observations):
        carried.reset(np.random.default_rng(i))
        assert carried.choose(obs).reason.endswith("the best of 5")
        sight = pushes.see(obs)
        candidates = draw_pushes(5, np.random.default_rng(i), pushes.full_steps)
        best = candidates[int(pushes.judge(candidates, sight).argmax())]
        assert f"towards {np.rad2deg(best.direction):.0f} degrees" in carried.choose(obs).reason
    words[2] = str(exported_actor.parent / "policy.safetensors")
    with pytest.raises(SystemExit):
        main([*words, str(tmp_path / "none"), "--candidates", "5"])
    assert "is to judge 5 candidates; expected none: it judges no" in capsys.readouterr().err


def test_an_exported_actor_acts_as_in_pytorch(actor, exported_actor, observations):
    carried = open_policy(exported_actor)
    for obs in observations:
        np.testing.assert_allclose(carried.choose(obs).action, actor.act(obs), atol=1e-4)


def test_the_description_says_what_goes_in_and_comes_out(exported_pushes, exported_actor):
    for folder in (exported_pushes, exported_actor):
        described = open_policy(folder).description
        # K is the number of networks.
        check_described(described, folder / "policy.onnx", K=2)
        both = (*described.inputs.values(), *described.outputs.values())
        assert {tensor["dtype"] for tensor in both} <= {"float16", "float32"}
        assert (described.camera, described.image_size, described.opset) == ("overhead", 64, 18)


def changed(folder, place, **fields):
    shutil.copytree(folder, place)
    described = json.loads((place / "policy.json").read_text())
    (place / "policy.json").write_text(json.dumps(described | fields))
    return place


def test_what_another_version_wrote_is_refused(exported_pushes, tmp_path):
    other = changed(exported_pushes, tmp_path / "other", format=9, mechsearch="9.1")
    with pytest.raises(MechSearchError, match=r"format 9, written by mechsearch 9\.1"):
        open_policy(other)
    kind = changed(exported_pushes, tmp_path / "kind", kind="grasps")
    with pytest.raises(MechSearchError, match="'grasps'; choose one of pushes, actions"):
        open_policy(kind)
    swapped = changed(exported_pushes, tmp_path / "swapped", network="0" * 64)
    with pytest.raises(MechSearchError, match="not the network"):
        open_policy(swapped)
    with pytest.raises(MechSearchError, match="no exported policy at"):
        open_policy(tmp_path)


def test_what_has_no_network_is_not_exported(tmp_path, capsys):
    pytest.importorskip("onnxscript")
    from mechsearch.cli import main

    with pytest.raises(SystemExit):
        main(["export", "policy", "teacher-spiral", "--out", str(tmp_path / "out")])
    assert "PushTeacher, which is not exported" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_robot_needs_neither_pytorch_nor_simulator(exported_pushes):
    code = f"""
import sys
from mechsearch.robot.controller import Controller
from mechsearch.robot.policy import open_policy
open_policy({str(exported_pushes)!r})
import mechsearch.robot.bags
found = {{"torch", "mujoco", "embreex", "trimesh", "matplotlib", "pyarrow"}} & set(sys.modules)
raise SystemExit(f"imports {{found}}" if found else 0)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
