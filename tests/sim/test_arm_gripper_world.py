"""An arm that grasps: what comes up, what is refused, and the limits of its joints."""

import numpy as np
import pytest

from mechsearch.geometry import rotation_from_quaternion, yaw_quaternion
from mechsearch.grippers import GRIPPERS
from mechsearch.sim.arm import ARMS, OUT_OF_REACH, PANDA, SELF_COLLISION, UR5E
from mechsearch.sim.arm_gripper_world import ArmGripperWorld
from mechsearch.sim.gripper import HAND_LENGTH
from mechsearch.sim.lift import LiftFrame
from mechsearch.sim.motion import kinematics_of
from mechsearch.types import MechSearchError, Outcome

pytest.importorskip("mink")

JAWS = GRIPPERS["jaws-85"]


def at(x, y, z, yaw=0.0):
    return np.array([x, y, z, *yaw_quaternion(yaw)])


APART = np.array([at(0, 0, 0.015), at(0.15, 0, 0.015)])
START = np.array([0.1, 0.1, 0.2])


def small_cubes(boxes, arm):
    """Two 3 cm cubes of 50 g."""
    world = ArmGripperWorld([boxes.models["small0"], boxes.models["small1"]], arm, pusher=JAWS)
    world.reset(APART, START)
    return world


def keeps_its_limits(motion):
    assert motion.refusal is None
    assert 0 < motion.velocities.max() < 1
    assert 0 < motion.torques.max() < 1
    assert motion.margin > 0.04
    assert motion.touched == ()


@pytest.fixture(params=list(ARMS))
def arm(request):
    return ARMS[request.param]


def test_what_an_arm_grasps_comes_up_and_is_put_back_where_it_was(boxes, arm):
    world, film = small_cubes(boxes, arm), list[LiftFrame]()
    attempt = world.attempt(0, at(0, 0, 0.015, 0.3), film=film)
    assert (attempt.outcome, attempt.held) == (Outcome.SUCCESS, (0,))
    keeps_its_limits(world.motion)
    assert world.poses[0, 2] > 0.19
    # At most 0.25 m/s: 20 cm from rest to rest take 15/8 of 0.8 s; a frame is 25 ms.
    assert sum(frame.phase == "lift" for frame in film) * 0.025 == pytest.approx(1.5, abs=0.026)
    with pytest.raises(MechSearchError, match="holds something"):
        world.attempt(0, at(0, 0, 0.015))
    world.release(film)
    keeps_its_limits(world.motion)
    world.settle()
    np.testing.assert_allclose(world.poses[:, :3], APART[:, :3], atol=0.004)
    np.testing.assert_allclose(world.pusher_position, [0, 0, 0.25], atol=2e-3)
    phases = ["reach", "descend", "close", "lift", "shake", "lower", "open", "leave"]
    assert list(dict.fromkeys(frame.phase for frame in film)) == phases


def test_what_is_carried_to_the_tray_is_gone_and_the_rest_lies_as_it_lay(boxes, arm):
    world = small_cubes(boxes, arm)
    assert world.attempt(1, at(0.15, 0, 0.015)).held == (1,)
    short = world.motion.duration
    assert world.stow() == (1,)
    keeps_its_limits(world.motion)
    # 0.6 m and back, at 0.25 m/s at most.
    assert world.motion.duration > short + 2 * 15 / 8 * 0.5 / 0.25
    assert world.workspace.off_table(world.poses).tolist() == [False, True]
    np.testing.assert_allclose(world.poses[0], APART[0], atol=1e-3)
    np.testing.assert_allclose(world.pusher_position, [0.15, 0, 0.25], atol=2e-3)


def test_a_grasp_that_cannot_be_carried_out_to_its_end_is_refused_and_nothing_moves(boxes):
    world = small_cubes(boxes, UR5E)
    before = world.snapshot()
    # The tips would come there, but not 20 cm higher.
    edge = np.array([0.3, 0.3, 0.1])
    assert world._kinematics.refusal(world._kinematics.inverse(edge)) is None
    attempt = world.attempt(0, at(*edge))
    assert (attempt.outcome, attempt.held) == (Outcome.BLOCKED, ())
    assert world.motion.refusal == OUT_OF_REACH
    np.testing.assert_array_equal(world.snapshot(), before)
    assert world.attempt(0, APART[0]).held == (0,)


def test_a_way_that_swings_into_the_arm_between_two_points_of_it_is_refused():
    kinematics = kinematics_of(PANDA, JAWS)
    start = np.array([-0.559, -1.162, 0.535, -2.538, 0.49, 1.45, 1.759])
    above, turn = kinematics.position(start), kinematics.rotation(start)
    down = np.array([*above[:2], 0.002])
    angles = start
    for share in np.arange(1, 9) / 8:
        angles = kinematics.inverse(above + share * (down - above), angles, turn)
        assert kinematics.refusal(angles) is None
    assert kinematics.path(start, down, turn) == SELF_COLLISION


def test_no_joint_is_asked_for_more_than_it_gives_and_the_force_keeps_its_direction(boxes):
    world, still = small_cubes(boxes, PANDA), np.zeros(7)
    held = world._kinematics.dynamics(world._angles, still)
    aside = world._kinematics.inverse(np.add(world.pusher_position, [0.02, 0, 0]), world._angles)
    world._spring(20_000.0, JAWS.press, JAWS.pull)
    world._drive(aside, still, still)
    asked, most = world._motors.copy(), PANDA.of_joints("torque")
    # 100 N, 31 cm from the sixth joint, would take 31 N m and more; it gives 12.
    assert np.abs(asked / most).max() == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_array_equal(world._watch.torques, np.abs(asked))
    more = np.linalg.solve(held.inertia, asked - held.bias)
    mobility = held.jacobian @ np.linalg.solve(held.inertia, held.jacobian.T)
    force = np.linalg.solve(mobility, held.jacobian @ more)
    assert 20 < force[0] < 50
    np.testing.assert_allclose(force[1:3], 0, atol=1)


def test_no_joint_is_driven_faster_than_it_may(boxes):
    world, still, most = small_cubes(boxes, PANDA), np.zeros(7), PANDA.of_joints("velocity")
    aside = world._kinematics.inverse(world.pusher_position + np.array([0, 0.05, 0]))
    world._spring(20_000.0, JAWS.press, JAWS.pull)
    for _ in range(30):
        world._drive(aside + 0.4, still, still)
    assert 0.9 < (world._watch.speeds / most).max() < 1.001
    assert 0.9 < (world._watch.torques / PANDA.of_joints("torque")).max() < 1.001


def test_jaws_turn_the_shorter_way_and_to_a_tilt(boxes):
    world = small_cubes(boxes, UR5E)
    before = world._angles.copy()
    # Closing direction and tilt about x by 0.2 rad, with the jaws turned by nearly half.
    turn = at(0, 0, 0, 3.0)[3:]
    tilt = np.array([np.cos(0.1), np.sin(0.1), 0, 0])
    pose = np.array([0, 0, 0.03, *tilt])
    rotation = rotation_from_quaternion(tilt) @ rotation_from_quaternion(turn)
    plan, curve = world._approach(before, np.array([0, 0, 0.25]), pose[:3], rotation)
    assert np.abs(plan.angles[-1] - before).max() < np.pi / 2 + 0.4
    held = world._kinematics.rotation(curve.sum(axis=0))
    np.testing.assert_allclose(held[:, 2], rotation[:, 2], atol=1e-3)
    np.testing.assert_allclose(np.abs(held[:, 0] @ rotation[:, 0]), 1, atol=1e-3)


def test_a_snapshot_between_decisions_has_all_that_follows(boxes):
    world = small_cubes(boxes, UR5E)

    def go_on():
        world.push(np.array([0.05, 0.1, 0.18]))
        held = world.attempt(0, at(0, 0, 0.015)).held
        world.release()
        world.settle()
        world.push(world.pusher_position + np.array([0.04, 0, 0]))
        return held, world.snapshot().tobytes()

    saved = world.snapshot()
    first = go_on()
    world.restore(saved)
    assert go_on() == first


def test_the_hand_is_as_long_as_the_pusher_and_has_weight():
    kinematics = kinematics_of(UR5E, JAWS)
    model = kinematics._model
    assert model.site("tip").bodyid == model.body("wrist0").id
    np.testing.assert_allclose(model.body("wrist0").pos, [0, 0, HAND_LENGTH])
    assert model.body_gravcomp[model.body("wrist0").id] == 0
    assert model.body("wrist0").mass[0] == pytest.approx(JAWS.mass + 2 * JAWS.finger_mass)
    # Weight at the shoulder of a stretched arm, with and without the gripper.
    flat, still = np.array([0, 0, 0, 0, 0, 0.0]), np.zeros(6)
    more = kinematics.dynamics(flat, still).bias[1]
    model.body_mass[model.body("wrist0").id] = 0
    less = kinematics.dynamics(flat, still).bias[1]
    model.body_mass[model.body("wrist0").id] = JAWS.mass + 2 * JAWS.finger_mass
    assert abs(more) - abs(less) == pytest.approx(1.0 * 9.81 * (0.425 + 0.3922), rel=1e-6)
