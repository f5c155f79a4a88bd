"""Limits under injected faults, on a robot that only its guard moves."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mechsearch.camera import preset
from mechsearch.robot.controller import Controller
from mechsearch.robot.limits import MOVE, RETREAT, STOP, Guard, Limits, Motion, Tool
from mechsearch.robot.policy import Choice
from mechsearch.sim.scene import Wall
from mechsearch.types import MechSearchError
from tests.robot.simulated_robot import (
    BASE_FROM_WORKSPACE,
    IMAGES_EVERY,
    LIMITS,
    SimulatedRobot,
)


class Onwards:
    """A policy that always goes the same way."""

    camera = preset("overhead")

    def __init__(self, *way, searches=False):
        self.way = np.array(way, np.float32)
        self.description = SimpleNamespace(
            low=[-0.3, -0.3, 0.01], high=[0.3, 0.3, 0.25], searches=searches
        )

    def reset(self, rng): ...

    def choose(self, obs):
        return Choice(self.way, "goes on", None, None)


def rig(way=(-1.0, 0.5, 0.0), walls=(), **changes):
    limits = Limits(**LIMITS | changes)
    robot = SimulatedRobot(limits=limits, walls=walls)
    return robot, Controller(Onwards(*way), BASE_FROM_WORKSPACE, limits)


def check_limits(robot):
    limits, tips = robot.limits, np.array(robot.tips)
    side = np.subtract(limits.high, limits.low)
    assert robot.speeds.max() <= 1.05 * limits.speed
    assert max(robot.forces) <= 1.05 * limits.force
    assert (tips >= limits.low - 0.05 * side).all()
    assert (tips <= limits.high + 0.05 * side).all()


def check_retreat(robot, since, upwards=0.1):
    """Since a fault at most what a reaction takes, then straight up, then rest."""
    tips = np.array(robot.tips[since:])
    assert np.linalg.norm(tips[-1, :2] - tips[0, :2]) < 0.1 * robot.limits.speed + 0.01
    assert tips[-1, 2] - tips[0, 2] == pytest.approx(upwards, abs=0.005)
    assert robot.speeds[-20:].max() < 0.002


def test_a_motion_in_the_workspace_is_one_in_the_base_frame():
    robot, controller = rig(way=(-1.0, 0.0, 0.0))
    start = robot.tool().position
    motion = controller.step(robot.frame(), robot.tool(), 0.0)
    # The workspace's -x is the base's -y; an action is 5 cm.
    np.testing.assert_allclose(motion.goal - start, [0.0, -0.05, 0.0], atol=1e-7)
    assert (motion.kind, motion.speed, motion.reason) == (MOVE, 0.1, "goes on")
    robot.run(0.8, controller)
    # On the way it is the same motion; then there is the next.
    assert [m.goal[1] for m in robot.motions[:5]] == [motion.goal[1]] * 5
    assert robot.motions[-1].goal[1] == pytest.approx(motion.goal[1] - 0.05, abs=0.005)
    check_limits(robot)


def test_what_the_policy_sees_is_its_own_view_of_the_workspace():
    robot, controller = rig()
    controller.step(robot.frame(), robot.tool(), 0.0)
    own = robot.renderer.frame(preset("overhead"), robot.world.poses)
    target = own.modal(robot.heap.target)
    both = target & controller.seen.mask
    assert both.sum() > 0.6 * (target | controller.seen.mask).sum()
    np.testing.assert_allclose(
        np.median(np.abs(controller.seen.depth - own.depth)[both]), 0, atol=0.001
    )


FAULTS = {
    "stale images": (lambda f: replace(f, time=0.9), "old"),
    "images of the future": (lambda f: replace(f, time=f.time + 60), "-60.00 s old"),
    "black depth": (lambda f: replace(f, depth=0 * f.depth), "no depth"),
    "half of the depth lost": (
        lambda f: replace(f, depth=f.depth * (np.arange(320) % 320 < 150)),
        "no depth",
    ),
    "black colour": (lambda f: replace(f, colour=np.zeros((240, 320, 3), np.uint8)), "black"),
    "millimetres": (lambda f: replace(f, depth=1000 * f.depth), "millimetres"),
    "another size": (lambda f: replace(f, depth=f.depth[::2, ::2]), "shape (120, 160)"),
    "no mask": (lambda f: replace(f, mask=None), "no mask"),
    "a lost mask": (lambda f: replace(f, mask=np.zeros_like(f.mask)), "no target"),
    "other intrinsics": (lambda f: replace(f, camera=replace(f.camera, fx=300)), "intrinsics"),
    "a jump of 2 cm": (lambda f: replace(f, camera=moved(f.camera, 0.02, 0)), "jumped by 0.020 m"),
    "a turn of 3 degrees": (lambda f: replace(f, camera=moved(f.camera, 0, 3)), "3.0 degrees"),
}


def moved(camera, shift, turn):
    pose, angle = camera.pose, np.deg2rad(turn)
    pose[0, 3] += shift
    about_z = [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    pose[:3, :3] = pose[:3, :3] @ about_z
    return replace(camera, world_from_camera=tuple(pose.ravel().tolist()))


@pytest.mark.parametrize("fault", FAULTS)
def test_bad_images_stop_the_motion_and_send_the_tool_up(fault):
    change, says = FAULTS[fault]
    robot, controller = rig(lost_looks=2)
    robot.run(1.0, controller)
    assert not controller.refusal
    robot.run(3.0, controller, change)
    assert says in controller.refusal
    refused = [motion.kind for motion in robot.motions].index(RETREAT)
    check_retreat(robot, refused * IMAGES_EVERY)
    # What is right again does not set it off; somebody must.
    robot.run(0.2, controller)
    assert robot.motions[-1].kind == RETREAT
    controller.reset(np.random.default_rng(0))
    robot.run(0.3, controller)
    assert robot.motions[-1].kind == MOVE
    check_limits(robot)


@pytest.mark.parametrize(
    ("searches", "lost_looks", "looks"), [(False, None, 5), (True, None, 50), (True, 3, 3)]
)
def test_a_policy_that_searches_may_look_for_an_episode(searches, lost_looks, looks):
    limits = Limits(**LIMITS, lost_looks=lost_looks)
    robot = SimulatedRobot(limits=limits)
    policy = Onwards(0.0, 0.0, 0.0, searches=searches)
    controller = Controller(policy, BASE_FROM_WORKSPACE, limits)
    frame, tool = robot.frame(), robot.tool()
    lost = replace(frame, mask=np.zeros_like(frame.mask))
    for look in range(looks):
        assert not controller.refusal
        now = 10.0 * look
        controller.step(replace(lost, time=now), replace(tool, time=now), now)
    assert controller.refusal == f"no target is seen in {looks} images in a row"


def test_a_blocked_tool_presses_no_harder_than_it_may_and_goes_up():
    wall = Wall(0.0, 0.0, 0.29)
    robot, controller = rig((1.0, -0.75, 0.0), [wall], force=5.0)
    robot.run(3.0, controller)
    assert "N at the tool" in robot.guard.refusal + controller.refusal
    assert max(robot.forces) > 3.9
    assert robot.tips[-1][2] > robot.tips[0][2] + 0.08
    check_limits(robot)


def test_a_tool_that_is_pressed_down_does_not_go_up():
    limits = Limits(**LIMITS)
    tool = Tool(np.array([0.5, 0.0, 0.2]), 0.0, np.array([0.0, 0.0, -18.0]))
    guard = Guard(limits)
    guard.receive(Motion(MOVE, np.array([0.6, 0.0, 0.2]), 0.1, 0.0, ""), 0.0)
    for tick in range(100):
        point = guard.set_point(replace(tool, time=tick / 200), tick / 200)
    assert "18.0 N" in guard.refusal
    np.testing.assert_array_equal(point, tool.position)


def test_a_killed_controller_ends_in_a_stop_above():
    robot, controller = rig()
    robot.run(1.2, controller)
    since = len(robot.tips)
    assert robot.speeds[-1] > 0.03
    robot.run(2.5)
    assert "no command for 0.3" in robot.guard.refusal
    reacted = since + round(0.31 / 0.005)
    check_retreat(robot, reacted)
    # Nor do the controller's last words reach it.
    robot.run(0.5, controller)
    check_retreat(robot, reacted)
    check_limits(robot)


@pytest.mark.parametrize("to", ["controller", "guard"])
def test_the_stop_stops_and_nothing_else(to):
    robot, controller = rig()
    robot.run(1.2, controller)
    since, robot.stop = len(robot.tips), True
    robot.run(1.0, controller if to == "controller" else None)
    way = np.linalg.norm(robot.tips[-1] - robot.tips[since])
    assert way < 0.01
    robot.stop = False
    robot.run(0.5, controller)
    assert np.linalg.norm(robot.tips[-1] - robot.tips[since]) < 0.01
    if to == "controller":
        assert robot.motions[-1].kind == STOP
    check_limits(robot)


def test_a_joint_near_its_end_stops_the_motion_where_it_is():
    """Two links of 0.5 m from the base to the tip: as it goes outwards, the elbow opens."""

    def elbow(tip):
        return {"elbow": 2 * np.arcsin(np.linalg.norm(tip))}

    ends = {"elbow": (0.2, 2.0)}
    robot, controller = rig((0.0, -1.0, 0.0), joints=ends)
    robot.joints = elbow
    robot.run(6.0, controller)
    assert "joint elbow" in robot.guard.refusal
    assert robot.speeds[-50:].max() < 0.002
    opened = [elbow(tip)["elbow"] for tip in robot.tips]
    assert opened[0] < 1.7
    # Within 5 % of a margin of 0.05 rad, and it did get near.
    assert 1.9 < max(opened) < 1.95 + 0.05 * 0.05
    assert np.ptp(np.array(robot.tips)[-50:], axis=0).max() < 0.002
    # The controller looks by itself.
    at = Tool(robot.tips[-1], 0.0, joints={"elbow": 1.96})
    frame = replace(robot.frame(), time=0.0)
    _, other = rig((0.0, -1.0, 0.0), joints=ends)
    assert other.step(frame, at, 0.0).kind == STOP
    assert "joint elbow is at 1.960 rad" in other.refusal
    _, other = rig((0.0, -1.0, 0.0), joints=ends)
    other.step(frame, replace(at, joints={"wrist": 0.0}), 0.0)
    assert other.refusal == "joint elbow is not measured"
    with pytest.raises(MechSearchError, match=r"joint elbow goes from 0\.0 to 0\.1 rad"):
        Limits(**LIMITS, joints={"elbow": (0.0, 0.1)})


def test_a_dry_run_decides_all_and_moves_nothing():
    robot, controller = rig(dry_run=True)
    robot.run(1.0, controller)
    assert {motion.kind for motion in robot.motions} == {MOVE}
    np.testing.assert_allclose(robot.tips[-1], robot.tips[0], atol=1e-4)


def test_the_guard_trusts_no_controller():
    robot, _ = rig()
    for goal in ([5.0, 5.0, 5.0], [-5.0, 0.5, 0.2], [0.5, 0.0, -3.0]):
        wild = SimpleNamespace(
            step=lambda *_, goal=goal: Motion(MOVE, np.array(goal), 50.0, robot.now, "wild")
        )
        robot.run(4.0, wild)
    tips = np.array(robot.tips)
    assert (tips > np.subtract(LIMITS["low"], 0.001)).all()
    assert (tips < np.add(LIMITS["high"], 0.001)).all()
    assert robot.speeds.max() <= 1.05 * 0.1


@pytest.mark.parametrize(
    "changes",
    [{"kind": "jump"}, {"goal": np.array([0.5, np.nan, 0.1])}, {"speed": 0.0}, {"speed": np.nan}],
)
def test_what_is_no_motion_moves_nothing(changes):
    guard, here = Guard(Limits(**LIMITS)), np.array([0.5, 0.0, 0.1])
    motion = Motion(MOVE, here + 0.05, 0.1, 0.0, "")
    guard.receive(replace(motion, **changes), 0.0)
    assert guard.refusal.startswith("no motion")
    assert guard.set_point(Tool(here, 0.01), 0.01).tolist() == here.tolist()


def test_a_robot_that_measures_nothing_stands():
    robot, controller = rig()
    lost = replace(robot.tool(), time=-1.0)
    motion = controller.step(robot.frame(), lost, 0.0)
    assert (motion.kind, "measured" in motion.reason) == (STOP, True)
    robot.guard.set_point(lost, 0.0)
    assert "measurement" in robot.guard.refusal


def test_a_table_that_is_elsewhere_is_refused_before_anything_moves():
    limits = Limits(**LIMITS)
    away = BASE_FROM_WORKSPACE + np.outer([1, 0, 0, 0], [0, 0, 0, 1.0])
    with pytest.raises(MechSearchError, match="base_from_workspace right"):
        Controller(Onwards(1, 0, 0), away, limits)
    tipped = BASE_FROM_WORKSPACE[:, [2, 0, 1, 3]]
    with pytest.raises(MechSearchError, match="z axis"):
        Controller(Onwards(1, 0, 0), tipped, limits)
    with pytest.raises(MechSearchError, match="rigid"):
        Controller(Onwards(1, 0, 0), 2 * BASE_FROM_WORKSPACE, limits)
    with pytest.raises(MechSearchError, match="speed is -1"):
        Limits(**LIMITS, speed=-1)
    with pytest.raises(MechSearchError, match="box"):
        Limits(LIMITS["high"], LIMITS["low"])
    # Its farthest corner is (0.3, -0.6, 0.2): 0.7 m away.
    box = {"low": (-0.2, -0.6, 0.1), "high": (0.3, 0.3, 0.2)}
    assert Limits(**box, reach=0.701).reach == 0.701
    for reach in (0.699, -1, np.nan):
        with pytest.raises(MechSearchError, match=rf"up to 0\.700 m .* reach of {reach}"):
            Limits(**box, reach=reach)
