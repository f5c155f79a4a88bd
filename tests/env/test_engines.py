"""The engine as part of the task; what it computes is tested in `sim/test_bullet.py`."""

import importlib.util
import json
from dataclasses import asdict

import numpy as np
import pytest

from mechsearch import run_config
from mechsearch.env import HeapEnv, HeapEnvConfig, RetrievalTask, TaskConfig, task_from_json
from mechsearch.evaluation.rollout import evaluate, other_inputs, replay_all
from mechsearch.heaps.dataset import Heap
from mechsearch.heaps.generate import GenerateConfig, generate
from mechsearch.sim import PhysicsConfig
from mechsearch.types import MechSearchError

START = TaskConfig(max_actions=1)
BULLET = TaskConfig(engine="bullet", max_actions=4)


def test_an_evaluation_keeps_its_engine_and_is_verified(tmp_path):
    pytest.importorskip("pybullet", reason="the extra bullet is not installed")
    heaps = tmp_path / "heaps.parquet"
    generate(GenerateConfig(heaps=6, counts=(3,), seed=8), heaps)
    ours = {e.heap_seed: e for e in evaluate("idle", heaps, task=START).episodes}
    theirs = evaluate("teacher-spiral", heaps, task=BULLET)
    assert (theirs.header["env"]["engine"], theirs.header["engine"]) == ("bullet", "3.2.7")
    assert "engine mujoco -> bullet" in theirs.header["task_differs"]
    for other in theirs.episodes:
        one = ours[other.heap_seed]
        np.testing.assert_array_equal(one.ee_positions[0], other.ee_positions[0])
        assert (one.poses[0] != other.poses[0]).any()
        np.testing.assert_allclose(one.poses[0, :, :3], other.poses[0, :, :3], atol=0.02)
    assert all(check.passed for check in replay_all(theirs, heaps))


def test_a_heap_that_does_not_come_to_rest_is_left_out_by_name(covered, boxes):
    pytest.importorskip("pybullet", reason="the extra bullet is not installed")
    beside = covered.poses + np.array([0.5, 0, 0, 0, 0, 0, 0])
    heap = Heap(covered.objects, beside, 0, 0.75, 1234, 3, "single", False)
    env = HeapEnv([heap], boxes, HeapEnvConfig(engine="bullet"))
    with pytest.raises(
        RuntimeError, match="does not come to rest in Bullet: cube, lid, small0 left"
    ):
        env.reset()


def test_who_needs_snapshots_is_told_that_there_are_none():
    pytest.importorskip("pybullet", reason="the extra bullet is not installed")
    with pytest.raises(MechSearchError, match="the engine bullet has no snapshots"):
        evaluate("look-ahead", limit=1, task=BULLET)


def test_a_missing_engine_is_told_before_anything_is_simulated(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MechSearchError, match=r"the engine bullet .* `pip install '.\[bullet\]'`"):
        evaluate("idle", limit=1, task=BULLET)


def test_what_earlier_versions_wrote_was_simulated_by_mujoco():
    task = json.loads(json.dumps(asdict(TaskConfig())))
    earlier = {name: value for name, value in task.items() if name != "engine"}
    assert task_from_json(TaskConfig, earlier) == TaskConfig()
    assert other_inputs({"env": earlier}, {"env": task}) == ()
    assert other_inputs({"env": earlier}, {"env": {**task, "engine": "bullet"}}) == ("env",)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: TaskConfig(engine="ode"), "unknown engine 'ode'; choose one of mujoco, bullet"),
        (lambda: RetrievalTask(engine="bullet"), "grippers are simulated by mujoco alone"),
        (
            lambda: TaskConfig(engine="bullet", physics=PhysicsConfig(solver_iterations=9)),
            "physics.solver_iterations is 9; expected 30, bullet has its own",
        ),
    ],
)
def test_what_an_engine_cannot_is_refused(make, text):
    with pytest.raises(MechSearchError, match=text):
        make()


def test_runs_learn_in_mujoco():
    pytest.importorskip("torch")
    with pytest.raises(MechSearchError, match="runs learn in mujoco, and `mechsearch evaluate RUN"):
        run_config("plus").changed(engine="bullet")
