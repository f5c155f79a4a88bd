"""Exported grasp networks: the same grasps as in PyTorch, in the base frame, or refused."""

import json
import shutil
from dataclasses import asdict, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mechsearch.cli import main
from mechsearch.grippers import Aligned, grasp_camera, gripper_named, height_map
from mechsearch.observe.reprojection import reproject
from mechsearch.robot.controller import Controller
from mechsearch.robot.grasper import open_grasper, view_of_robot
from mechsearch.robot.limits import (
    APPROACH,
    GRASPING,
    MOVE,
    RETREAT,
    Guard,
    Limits,
    Motion,
    PlannedGrasp,
    Tool,
)
from mechsearch.types import MechSearchError
from tests.robot.described import check_described
from tests.robot.simulated_robot import (
    BASE_FROM_WORKSPACE,
    LIMITS,
    SEEN_HEAP,
    SimulatedRobot,
    own_camera,
)
from tests.robot.test_limits import Onwards

BOX = Limits(**LIMITS)
ASKED = PlannedGrasp(np.array([0.45, 0.1, 0.12]), np.array([1.0, 0, 0, 0]), 0.085, 0.95, "jaws-85")
START = np.array([0.6, -0.1, 0.14])


@pytest.fixture(scope="module")
def frames():
    """Images of three heaps, from places of the camera's own, with holes."""
    rng, seen = np.random.default_rng(0), []
    for number in range(3):
        robot = SimulatedRobot(number)
        robot.camera = own_camera(640, 480, tilt=0.15 * number)
        frame = robot.frame()
        holes = rng.random(frame.depth.shape) < 0.05
        seen.append(replace(frame, depth=np.where(holes, 0, frame.depth).astype(np.float32)))
    return seen


@pytest.mark.parametrize("gripper", ["jaws-85", "suction"])
def test_grasps_are_pytorchs_in_the_base_frame(exported_grasps, frames, gripper):
    from mechsearch.grasp.planner import GraspPlanner

    theirs, carried = GraspPlanner(gripper), open_grasper(exported_grasps / gripper)
    planned = 0
    for seed, frame in enumerate(frames):
        view = view_of_robot(frame.depth, frame.mask, frame.camera, BASE_FROM_WORKSPACE)
        expected = theirs.plan(view, np.random.default_rng(seed))
        found = carried.plan(
            frame.depth, frame.mask, frame.camera, np.random.default_rng(seed), BASE_FROM_WORKSPACE
        )
        np.testing.assert_allclose([g.quality for g in found], expected.quality, atol=1e-4)
        planned += len(found)
        for grasp, pose in zip(found[:1], expected.poses, strict=False):
            # The workspace's x is the base's y, its y the base's -x, and it lies at (0.5, 0, 0.1).
            own = Rotation.from_quat(pose[3:], scalar_first=True).as_matrix()
            tip = pose[:3] - own[:, 2] * (0.01 if gripper == "jaws-85" else 0.0)
            np.testing.assert_allclose(
                grasp.position, [0.5 - tip[1], tip[0], tip[2] + 0.1], atol=1e-9
            )
            turned = np.stack([-own[1], own[0], own[2]])
            np.testing.assert_allclose(
                Rotation.from_quat(grasp.quaternion, scalar_first=True).as_matrix(), turned,
                atol=1e-9,
            )  # fmt: skip
            np.testing.assert_allclose(grasp.approach, -turned[:, 2], atol=1e-9)
            assert grasp.opening == {"jaws-85": 0.085, "suction": 0.0}[gripper]
            assert grasp.gripper == gripper
    assert planned > 20


def test_what_is_not_looked_at_makes_no_difference(frames):
    for frame in frames:
        part = view_of_robot(frame.depth, frame.mask, frame.camera, BASE_FROM_WORKSPACE)
        pose = np.linalg.inv(BASE_FROM_WORKSPACE) @ frame.camera.pose
        own = replace(frame.camera, world_from_camera=tuple(pose.ravel()))
        seen = reproject(frame.depth, own, grasp_camera(), frame.mask)
        whole = replace(part, depth=seen.depth, mask=seen.mask, camera=grasp_camera())
        assert part.depth.size < 0.8 * whole.depth.size
        found, expected = height_map(part), height_map(whole)
        # A point on the border of two cells may fall into either.
        assert np.isclose(found.height, expected.height, atol=1e-4).mean() > 0.999
        assert (found.target == expected.target).mean() > 0.999
        np.testing.assert_allclose(found.corner, expected.corner, atol=1e-9)


def test_the_description_says_what_goes_in_and_comes_out(exported_grasps):
    for gripper, patch in (("jaws-85", [32, 64]), ("suction", [32, 32])):
        described = open_grasper(exported_grasps / gripper).description
        check_described(described, exported_grasps / gripper / "grasps.onnx")
        for tensor in (*described.inputs.values(), *described.outputs.values()):
            assert tensor["shape"][0] == "N"
            assert tensor["dtype"] in ("bool", "float32")
        assert described.inputs["relative"]["shape"] == ["N", *patch]
        assert described.gripper == {"name": gripper, **asdict(gripper_named(gripper))}
        assert described.card["name"] == gripper


def test_a_network_of_ones_own_is_exported(tmp_path):
    pytest.importorskip("onnxscript")
    import torch

    from mechsearch.grasp.network import ready
    from mechsearch.grasp.quality_network import QualityNetwork, save_quality_network

    torch.manual_seed(0)
    network = ready(QualityNetwork("jaws-56"))
    save_quality_network(tmp_path / "mine.safetensors", network, {"epochs": 3})
    main(["export", "grasps", str(tmp_path / "mine.safetensors"), "--out", str(tmp_path / "out")])
    carried = open_grasper(tmp_path / "out")
    assert carried.gripper == gripper_named("jaws-56")
    assert carried.description.card["epochs"] == 3
    drawn = np.random.default_rng(0)

    seen = Aligned(
        drawn.normal(0, 0.02, (5, 32, 64)).astype(np.float32), drawn.random((5, 32, 64)) < 0.5,
        drawn.normal(0, 0.05, (5, 6)).astype(np.float32),
    )  # fmt: skip
    found = carried.quality(seen)
    np.testing.assert_allclose(found, network.quality(seen), atol=1e-5)
    assert np.ptp(found) > 1e-3


def test_what_is_no_grasp_network_is_refused(exported_grasps, exported_pushes, tmp_path, capsys):
    described = json.loads((exported_grasps / "jaws-85" / "grasps.json").read_text())
    for number, (changes, words) in enumerate([
        ({"format": 9, "mechsearch": "9.1"}, r"format 9, written by mechsearch 9\.1"),
        ({"kind": "pushes"}, "'pushes'; choose one of jaws, suction"),
        ({"network": "0" * 64}, "not the network"),
        ({"gripper": {"name": "jaws-85", "opening": "wide"}}, "opening is 'wide'"),
    ]):  # fmt: skip
        place = tmp_path / str(number)
        shutil.copytree(exported_grasps / "jaws-85", place)
        (place / "grasps.json").write_text(json.dumps(described | changes))
        with pytest.raises(MechSearchError, match=words):
            open_grasper(place)
    with pytest.raises(MechSearchError, match="no exported grasps at"):
        open_grasper(exported_pushes)
    with pytest.raises(SystemExit):
        main(["export", "grasps", "tongs", "--out", str(tmp_path / "out")])
    assert "no gripper 'tongs'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def carried_out(motion, ready_after=None, seconds=8.0):
    """Return where a tool goes (T, 3) that follows its guard exactly, 200 times a second."""
    guard, position, tips = Guard(BOX), START.copy(), []
    for tick in range(round(200 * seconds)):
        now = tick / 200
        guard.receive(motion, now)
        ready = ready_after is not None and now >= ready_after
        position = guard.set_point(Tool(position, now, ready=ready), now)
        tips.append(position)
    return guard, np.array(tips)


def asked(grasp, **changes):
    return replace(Motion(GRASPING, grasp.position, 0.1, 0.0, "", grasp=grasp), **changes)


@pytest.mark.parametrize("tilt", [0.0, 0.5])
def test_a_guard_brings_the_tool_down_along_the_approach_once_it_is_ready(tilt):
    turn = Rotation.from_euler("x", tilt).as_quat(scalar_first=True)
    grasp = replace(ASKED, quaternion=turn)
    begin = ASKED.position + APPROACH * np.array([0, -np.sin(tilt), np.cos(tilt)])
    np.testing.assert_allclose(grasp.begin, begin, atol=1e-12)
    _, waiting = carried_out(asked(grasp), None)
    np.testing.assert_allclose(waiting[-1], begin, atol=0.006)
    _, tips = carried_out(asked(grasp), ready_after=8.0, seconds=11.0)
    np.testing.assert_allclose(tips[-1], ASKED.position, atol=0.001)
    # Sideways it goes at the top of the box; below its begin, on the line of the approach.
    aside = np.linalg.norm(np.diff(tips[:, :2], axis=0), axis=1) > 1e-4
    low = tips[1:, 2] < BOX.high[2] - 0.006
    before = np.arange(len(low)) < 200 * 8 - 1
    assert not (aside & low & before).any()
    down = tips[200 * 8 :] - ASKED.position
    line = (begin - ASKED.position) / APPROACH
    assert np.linalg.norm(down - (down @ line)[:, None] * line, axis=1).max() < 0.006
    assert np.linalg.norm(np.diff(tips, axis=0), axis=1).max() * 200 <= BOX.speed


@pytest.mark.parametrize(
    ("fault", "words", "up"),
    [
        ({"force": np.array([0.0, 0.0, 17.0])}, "17.0 N at the tool", 0.1),
        ({}, "no command for 0.30 s", 0.1),
        ({"stop": True}, "the stop is pressed", 0.0),
        ({"joints": {"elbow": 1.97}}, "joint elbow is at 1.970 rad", 0.0),
    ],
)
def test_a_guard_leaves_a_grasp_for_the_limits_of_any_motion(fault, words, up):
    guard = Guard(replace(BOX, joints={"elbow": (-2.0, 2.0)}))
    tool = Tool(ASKED.begin - [0, 0, 0.02], 0.0, joints={"elbow": 0.0}, ready=True)
    guard.receive(asked(ASKED), 0.0)
    tips = [tool.position]
    for now in np.arange(1, 400) / 200:
        wrong = fault if now > 0.2 else {}
        if fault and not wrong:
            guard.receive(asked(ASKED), now)
        stop = wrong.get("stop", False)
        tool = replace(tool, time=now, **{k: v for k, v in wrong.items() if k != "stop"})
        tool = replace(tool, position=guard.set_point(tool, now, stop))
        tips.append(tool.position)
    assert guard.refusal.startswith(words)
    lowest = min(tip[2] for tip in tips)
    # Down for 0.2 s, or 0.3 s in silence, and no farther than a reaction takes.
    assert ASKED.position[2] < lowest < tips[0][2] - 0.01
    np.testing.assert_allclose(tips[-1], [*ASKED.position[:2], lowest + up], atol=0.005)


def test_a_guard_refuses_grasps_outside_the_box_and_what_is_no_turn():
    high = replace(ASKED, position=np.array([0.45, 0.1, 0.3]))
    for motion, words in (
        (asked(replace(ASKED, position=np.array([0.45, 0.1, 0.095]))), "0.010 m outside the box"),
        (asked(high), "begins, 0.040 m outside the box"),
        (asked(replace(ASKED, quaternion=np.array([1.0, 1.0, 0, 0]))), "no motion"),
        (asked(replace(ASKED, quaternion=np.full(4, np.nan))), "no motion"),
        (asked(ASKED, kind=MOVE), "no motion"),
        (replace(asked(ASKED), grasp=None), "no motion"),
    ):
        guard, tips = carried_out(motion, 0.0, 0.5)
        assert words in guard.refusal
        np.testing.assert_array_equal(tips, np.tile(START, (len(tips), 1)))


class Planned:
    """A grasper that knows its grasps already."""

    def __init__(self, *grasps):
        self.grasps = list(grasps)

    def plan(self, *given):
        return self.grasps


@pytest.fixture(scope="module")
def seen():
    robot = SimulatedRobot(SEEN_HEAP)
    return robot.frame(), robot.tool()


def controller_of(*grasps, **options):
    onwards = Onwards(-1.0, 0.5, 0.0)
    rng = np.random.default_rng(0)
    return Controller(onwards, BASE_FROM_WORKSPACE, BOX, rng, None, Planned(*grasps), **options)


def test_a_controller_grasps_where_that_is_good_enough_and_pushes_elsewhere(seen):
    frame, tool = seen
    motion = controller_of(ASKED).step(frame, tool, 0.0)
    assert (motion.kind, motion.confidence, motion.expects.lifted) == (GRASPING, 0.95, 0.95)
    assert motion.grasp is ASKED
    np.testing.assert_array_equal(motion.goal, ASKED.position)
    assert motion.reason == "the best of 1 grasps, rated 0.95"
    poor, outside = replace(ASKED, quality=0.4), replace(ASKED, position=np.array([0.9, 0, 0.12]))
    for grasps, options, words in (
        ([poor], {}, "goes on; the best grasp is rated 0.40"),
        ([], {}, "goes on; there is no place for a grasp"),
        ([outside], {}, "0.080 m outside the box"),
    ):
        motion = controller_of(*grasps, **options).step(frame, tool, 0.0)
        assert (motion.kind, motion.grasp) == (MOVE, None)
        assert words in motion.reason
    assert controller_of(poor, grasp_from=0.0).step(frame, tool, 0.0).kind == GRASPING
    # The next best is in the box.
    assert controller_of(outside, ASKED).step(frame, tool, 0.0).grasp is ASKED
    with pytest.raises(MechSearchError, match="grasp_from is nan; expected a chance"):
        controller_of(ASKED, grasp_from=float("nan"))


def test_a_grasp_stays_until_somebody_resets_the_controller_or_a_limit_is_met(seen):
    frame, tool = seen
    controller = controller_of(ASKED)
    controller.step(frame, tool, 0.0)
    there = replace(tool, position=ASKED.position)
    for now in (0.1, 60.0, 120.0):
        at = replace(there, time=now), now
        assert controller.step(replace(frame, time=now), *at).grasp is ASKED
    controller.reset(np.random.default_rng(0))
    assert controller.step(replace(frame, time=200.0), replace(tool, time=200.0), 200.0).time == 200
    # On its way the limits of images hold as they do for pushes.
    stale = controller.step(replace(frame, time=200.0), replace(tool, time=201.0), 201.0)
    assert stale.kind == RETREAT
    assert "old" in stale.reason


def test_a_grasp_that_gets_nowhere_is_thought_over(seen):
    frame, tool = seen
    controller = controller_of(ASKED)
    controller.step(frame, tool, 0.0)
    controller._grasper.grasps = []
    kinds = [
        controller.step(replace(frame, time=now), replace(tool, time=now), now).kind
        for now in np.arange(0.5, 30.0, 0.5)
    ]
    # 0.2 m up, 0.3 m aside and 0.2 m down, at 0.1 m/s, and 5 s for turning.
    until = (kinds.index(MOVE) + 1) * 0.5
    assert 10 < until < 18
