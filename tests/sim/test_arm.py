"""Arms against what their makers publish, and what they do and refuse."""

from math import cos, pi, sin

import mujoco
import numpy as np
import pytest

from mechsearch.sim import ARMS, ArmWorld, PhysicsConfig, Pusher, Workspace, World
from mechsearch.sim.arm import (
    JOINT_LIMIT,
    OUT_OF_REACH,
    PANDA,
    REFUSED,
    SELF_COLLISION,
    SINGULARITY,
    TABLE,
    UR5E,
)
from mechsearch.sim.motion import kinematics_of
from mechsearch.sim.scene import compile_scene
from mechsearch.types import MechSearchError

UR_TABLE = (
    (0, 0.1625, pi / 2), (-0.425, 0, 0), (-0.3922, 0, 0), (0, 0.1333, pi / 2),
    (0, 0.0997, -pi / 2), (0, 0.0996, 0),
)  # fmt: skip
"""The maker's: a and d [m] and alpha of each joint, in the standard convention."""

FRANKA_TABLE = (
    (0, 0.333, 0), (0, 0, -pi / 2), (0, 0.316, pi / 2), (0.0825, 0, pi / 2),
    (-0.0825, 0.384, -pi / 2), (0, 0, pi / 2), (0.088, 0, pi / 2), (0, 0.107, 0),
)  # fmt: skip
"""The maker's, in Craig's convention; the last is the flange, which does not turn."""

TOOL = Pusher()
REST = [0, 0, 0.03, 1, 0, 0, 0]


def turn_x(angle):
    c, s = cos(angle), sin(angle)
    return np.array([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]])


def turn_z(angle):
    c, s = cos(angle), sin(angle)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


def shift(x, z):
    place = np.eye(4)
    place[[0, 2], 3] = x, z
    return place


def ur5e_flange(q):
    whole = np.eye(4)
    for (a, d, alpha), angle in zip(UR_TABLE, q, strict=True):
        whole = whole @ turn_z(angle) @ shift(a, d) @ turn_x(alpha)
    return whole


def panda_flange(q):
    whole = np.eye(4)
    for (a, d, alpha), angle in zip(FRANKA_TABLE, (*q, 0), strict=True):
        whole = whole @ turn_x(alpha) @ shift(a, 0) @ turn_z(angle) @ shift(0, d)
    return whole


FLANGES = {"ur5e": ur5e_flange, "panda": panda_flange}


@pytest.fixture(params=list(ARMS))
def arm(request):
    return ARMS[request.param]


@pytest.fixture
def kinematics(arm):
    pytest.importorskip("mink")
    return kinematics_of(arm, TOOL)


def compiled(arm):
    model = compile_scene((), Workspace(), TOOL, (), PhysicsConfig(), arm=arm)
    return model, mujoco.MjData(model)


def test_forward_kinematics_is_the_product_of_the_published_matrices(arm):
    model, data = compiled(arm)
    base = turn_z(arm.yaw)
    base[:3, 3] = arm.base
    rng = np.random.default_rng(0)
    for angles in (np.zeros(model.nq), *rng.uniform(-pi, pi, (5, model.nq))):
        data.qpos[:] = angles
        mujoco.mj_kinematics(model, data)
        whole = base @ FLANGES[arm.name](angles)
        tip = whole @ [0, 0, TOOL.length, 1]
        np.testing.assert_allclose(data.site("tip").xpos, tip[:3], atol=1e-12)
        # The tool's z axis points back to the flange.
        np.testing.assert_allclose(data.site("tip").xmat[2::3], -whole[:3, 2], atol=1e-12)


def test_at_angles_of_zero_the_flanges_are_where_the_drawings_have_them():
    far, side, low = 0.425 + 0.3922, 0.1333 + 0.0996, 0.1625 - 0.0997
    np.testing.assert_allclose(ur5e_flange(np.zeros(6))[:3, 3], [-far, -side, low], atol=1e-12)
    high = 0.333 + 0.316 + 0.384 - 0.107
    np.testing.assert_allclose(panda_flange(np.zeros(7))[:3, 3], [0.088, 0, high], atol=1e-12)


def test_the_engine_holds_the_published_limits_and_masses(arm):
    model, _ = compiled(arm)
    ranges = np.stack([arm.of_joints("low"), arm.of_joints("high")], axis=1)
    np.testing.assert_allclose(model.jnt_range, ranges)
    np.testing.assert_allclose(model.actuator_forcerange[:, 1], arm.of_joints("torque"))
    masses = [model.body(f"link{i}").mass[0] for i in range(len(arm.links))]
    np.testing.assert_allclose(masses, arm.of_joints("mass"))
    assert arm.of_joints("mass").sum() == pytest.approx(
        {"ur5e": 17.7, "panda": 16.062}[arm.name], abs=1e-3
    )


def test_inverse_kinematics_holds_the_tool_upright_at_the_position_and_joints_in_their_ranges(
    kinematics,
):
    arm = kinematics.arm
    for position in np.random.default_rng(1).uniform(
        [-0.15, -0.2, 0.01], [0.2, 0.2, 0.25], (12, 3)
    ):
        angles = kinematics.inverse(position)
        assert (angles > arm.of_joints("low")).all()
        assert (angles < arm.of_joints("high")).all()
        base = turn_z(arm.yaw)
        base[:3, 3] = arm.base
        whole = base @ FLANGES[arm.name](angles)
        np.testing.assert_allclose((whole @ [0, 0, TOOL.length, 1])[:3], position, atol=1e-4)
        np.testing.assert_allclose(whole[:3, 2], [0, 0, -1], atol=1e-3)


@pytest.mark.parametrize(
    ("arm", "goal", "reason"),
    [
        (UR5E, (0, 0, 2), OUT_OF_REACH),
        (UR5E, (0, 0, -0.05), TABLE),
        (UR5E, (-0.3, 0, 0.01), SELF_COLLISION),
        (PANDA, (-0.3, 0, 0.13), JOINT_LIMIT),
    ],
)
def test_what_cannot_be_done_is_refused_by_name_and_nothing_moves(arm, goal, reason, boxes):
    pytest.importorskip("mink")
    world = ArmWorld([boxes.models["cube"]], arm)
    world.reset(np.array([REST]), np.array([0.0, 0.0, 0.15]))
    before = world.snapshot()
    assert not world.push(np.array(goal))
    assert world.motion.refusal == reason
    assert world.motion.duration == 0
    np.testing.assert_array_equal(world.snapshot(), before)


def test_a_stretched_elbow_is_a_singularity_and_a_joint_at_its_end_is_refused():
    pytest.importorskip("mink")
    kinematics = kinematics_of(UR5E, TOOL)
    stretched = np.array([0, -pi / 2, 0, -pi / 2, -pi / 2, 0])
    assert kinematics.refusal(np.array(UR5E.home)) is None
    assert kinematics.refusal(stretched) == SINGULARITY
    assert kinematics.refusal(np.array([*UR5E.home[:5], 2 * pi])) == JOINT_LIMIT


def test_an_arm_is_not_free_where_it_cannot_be(boxes):
    pytest.importorskip("mink")
    world = ArmWorld([boxes.models["cube"]], UR5E)
    world.reset(np.array([REST]), np.array([0.0, 0.0, 2.0]))
    assert not world.pusher_is_free()
    world.reset(np.array([REST]), np.array([0.0, 0.0, 0.03]))
    assert not world.pusher_is_free()
    world.reset(np.array([REST]), np.array([0.1, 0.0, 0.03]))
    assert world.pusher_is_free()
    # Only with its wrist turned over, in which it would soon be stuck.
    assert kinematics_of(PANDA, TOOL).inverse(np.array([-0.25, 0.01, 0.08])) == JOINT_LIMIT


def test_actions_end_within_a_millimetre_and_exceed_no_limit(kinematics):
    world = ArmWorld([], kinematics.arm)
    world.reset(np.zeros((0, 7)), np.array([0.0, 0.0, 0.1]))
    rng, moved = np.random.default_rng(2), 0
    for _ in range(20):
        way = rng.normal(size=3)
        goal = world.workspace.clip(world.pusher_position + 0.05 * way / np.linalg.norm(way))
        length = np.linalg.norm(goal - world.pusher_position)
        world.push(goal)
        motion = world.motion
        if motion.refusal is not None:
            assert motion.refusal in REFUSED
            continue
        moved += 1
        np.testing.assert_allclose(world.pusher_position, goal, atol=1e-3)
        # Fast at its middle 15/8 of the mean, which is 0.25 m/s at most; then it stands 14 steps.
        assert motion.duration > 15 / 8 * length / 0.25
        assert motion.duration * 200 == pytest.approx(round(motion.duration * 200))
        assert 0 < motion.velocities.max() < 1
        assert 0 < motion.torques.max() < 1
        assert motion.margin > 0
        assert motion.touched == ()
    assert moved >= 15


def shoved(world):
    """Return where a cube is that two actions push towards its middle and 4 cm beyond."""
    world.reset(np.array([REST]), np.array([-0.06, 0, 0.03]))
    for _ in range(2):
        world.push(world.pusher_position + np.array([0.05, 0, 0]))
    return world.poses[0, 0]


def test_an_arm_pushes_as_the_free_pusher_does(boxes, arm):
    pytest.importorskip("mink")
    free = shoved(World([boxes.models["cube"]], pusher=TOOL))
    held = shoved(ArmWorld([boxes.models["cube"]], arm))
    # In front of the fingers; what the free pusher shoves, which is faster, slides on.
    assert held == pytest.approx(0.04 + TOOL.radius + 0.03, abs=1e-3)
    assert held < free < held + 0.015


def test_an_arm_presses_no_harder_than_the_task_says(make_box, arm):
    pytest.importorskip("mink")
    # It begins to slide at 0.6 x 5 kg x 9.81 m/s^2 = 29 N, between the two.
    heavy = [make_box("heavy", (0.06, 0.06, 0.06), 5.0)]
    # Its own mass gives a blow at first.
    assert abs(shoved(ArmWorld(heavy, arm, pusher=Pusher(force=20.0)))) < 3e-3
    assert shoved(ArmWorld(heavy, arm, pusher=Pusher(force=45.0))) > 0.02


def test_a_snapshot_continues_bit_by_bit_and_a_link_that_meets_the_heap_is_told(make_box):
    pytest.importorskip("mink")
    tower = make_box("tower", (0.06, 0.06, 0.5), 1.0)
    world = ArmWorld([tower], UR5E)
    # The wrist comes to stand where the tower is, which the fingers pass.
    world.reset(np.array([[-0.1, 0.09, 0.25, 1, 0, 0, 0]]), np.array([0.0, 0.02, 0.05]))
    saved, told = world.snapshot(), []
    for _ in range(2):
        world.restore(saved)
        for _ in range(3):
            world.push(world.pusher_position + np.array([-0.05, 0.0, 0.0]))
            told.append(world.motion.touched)
        end = world.snapshot()
        world.push(np.array([0.1, 0.1, 0.2]))
    world.restore(saved)
    for _ in range(3):
        world.push(world.pusher_position + np.array([-0.05, 0.0, 0.0]))
    np.testing.assert_array_equal(world.snapshot(), end)
    assert ("heap",) in told


def test_without_the_library_an_arm_says_how_to_install_it(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(MechSearchError, match="install it by `pip install --no-deps mink qps"):
        ArmWorld([], UR5E, pusher=Pusher(radius=0.011))
