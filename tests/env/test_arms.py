"""The robot as part of the task."""

from dataclasses import asdict

import numpy as np
import pytest

from mechsearch.env import (
    Decision,
    HeapEnv,
    HeapEnvConfig,
    RetrievalTask,
    RetrieveConfig,
    RetrieveEnv,
    TaskConfig,
    task_from_json,
)
from mechsearch.evaluation.rollout import evaluate, other_inputs, replay_all
from mechsearch.heaps.dataset import embedded_file
from mechsearch.sim.arm import REFUSED
from mechsearch.sim.arm_gripper_world import ArmGripperWorld
from mechsearch.types import MechSearchError

DOWN = (1.0, 0.0, 0.0, 0.0)
FIXED = {"heap": 0, "fixed_start": True}
HEAPS = embedded_file("single")


def test_a_refused_action_costs_one_and_says_why(covered, boxes):
    pytest.importorskip("mink")
    env = HeapEnv([covered], boxes, HeapEnvConfig(robot="ur5e", max_actions=2))
    env.reset(options=FIXED)
    env.world.place_pusher(np.array([-0.27, 0.0, 0.02]))
    before = env.state
    _, reward, *_, info = env.step(np.array([-0.6, 0.0, -0.2]))
    assert info["refused"] == info["motion"].refusal == "self-collision"
    assert reward == -0.5
    np.testing.assert_array_equal(env.state.poses, before.poses)
    np.testing.assert_array_equal(env.state.ee_position, before.ee_position)
    *_, truncated, info = env.step(np.array([0.0, 0.0, 1.0]))
    assert truncated
    assert info["refused"] is None
    np.testing.assert_allclose(env.state.ee_position[2], before.ee_position[2] + 0.05, atol=1e-3)


def test_a_free_pusher_has_no_motion_and_every_robot_starts_where_the_heap_says(covered, boxes):
    pytest.importorskip("mink")
    starts = []
    for robot in ("free", "ur5e", "panda"):
        env = HeapEnv([covered], boxes, HeapEnvConfig(robot=robot))
        env.reset(options=FIXED)
        starts.append(env.state.ee_position)
        *_, info = env.step(np.zeros(3))
        assert ("motion" in info) == ("refused" in info) == (robot != "free")
    np.testing.assert_allclose(starts[1:], [starts[0]] * 2, atol=1e-4)


def test_episodes_of_an_arm_are_played_again_bit_by_bit():
    pytest.importorskip("mink")
    task = TaskConfig(robot="ur5e", max_actions=4)
    found = evaluate("teacher-spiral", HEAPS, limit=1, task=task)
    assert found.header["env"]["robot"] == "ur5e"
    assert all(check.passed for check in replay_all(found, HEAPS))
    grasps = RetrievalTask(robot="panda", max_grasps=1)
    again = evaluate("grasp-only", HEAPS, limit=1, task=grasps)
    assert all(check.passed for check in replay_all(again, HEAPS))
    free = evaluate("teacher-spiral", HEAPS, limit=1, task=TaskConfig(max_actions=4))
    assert other_inputs(found.header, free.header) == ("env",)
    # A file of an earlier version says nothing of robots.
    old = free.header | {"env": {k: v for k, v in free.header["env"].items() if k != "robot"}}
    assert other_inputs(old, free.header) == ()
    assert task_from_json(HeapEnvConfig, old["env"]).robot == "free"


def test_an_arm_puts_clutter_aside_and_retrieves(covered, boxes):
    pytest.importorskip("mink")
    blind = RetrieveConfig(robot="ur5e", keys=("ee_position", "grasps_left"))
    env = RetrieveEnv([covered], boxes, blind)
    env.reset(options=FIXED)
    before = env.state.poses
    far = env.step(Decision.grasp((-0.38, 0.0, 0.02, *DOWN)).vector())[4]
    assert (far["outcome"], far["grasps"], far["held"]) == ("blocked", 1, ())
    assert far["refused"] == far["motion"].refusal in REFUSED
    np.testing.assert_array_equal(env.state.poses, before)
    told = []
    for decision in (
        Decision.push((0, 0, 1.0)),
        Decision.remove((0.025, 0, 0.07, *DOWN)),
        Decision.grasp((0, 0, 0.03, *DOWN)),
    ):
        told.append(env.step(decision.vector())[4])
    assert [info["refused"] for info in told] == [None] * 3
    assert [info["held"] for info in told] == [(), (1,), (0,)]
    assert [info["outcome"] for info in told] == ["", "success", "success"]
    assert told[-1]["end"] == "retrieved"
    assert told[0]["motion"].duration < 1 < 5 < told[1]["motion"].duration


def test_what_falls_on_its_way_to_the_tray_is_not_retrieved(covered, boxes, monkeypatch):
    pytest.importorskip("mink")
    blind = RetrieveConfig(robot="ur5e", keys=("ee_position",))
    env = RetrieveEnv([covered], boxes, blind)
    env.reset(options=FIXED)
    follow = ArmGripperWorld._follow

    def opening(self, plan, film=None, phase=""):
        if phase == "carry":
            self.jaws.open()
        follow(self, plan, film, phase)

    monkeypatch.setattr(ArmGripperWorld, "_follow", opening)
    info = env.step(Decision.remove((0.15, 0.1, 0.015, *DOWN)).vector())[4]
    assert (info["outcome"], info["held"], info["retrieved"]) == ("dropped", (), False)
    assert env.state.poses[2, 2] < 0.05


def test_robots_are_refused_where_they_do_not_exist(covered, boxes, monkeypatch):
    with pytest.raises(
        MechSearchError, match="unknown robot 'ur10'; choose one of free, ur5e, pan"
    ):
        TaskConfig(robot="ur10")
    for grippers in (("suction",), ("jaws-85", "suction")):
        with pytest.raises(MechSearchError, match="the arm ur5e holds one of jaws-56, jaws-85"):
            RetrieveConfig(robot="ur5e", grippers=grippers)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(MechSearchError, match="robot 'panda' needs mink: install it by `pip inst"):
        HeapEnv([covered], boxes, HeapEnvConfig(robot="panda"))
    with pytest.raises(MechSearchError, match="robot 'panda' needs mink: install it by `pip inst"):
        RetrieveEnv([covered], boxes, RetrieveConfig(robot="panda"))
    # What was recorded with an arm is read without it.
    assert task_from_json(TaskConfig, asdict(TaskConfig(robot="panda"))).robot == "panda"
