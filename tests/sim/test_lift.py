import numpy as np
import pytest

from mechsearch.geometry import rotation_from_quaternion, yaw_quaternion
from mechsearch.grippers import Gripper
from mechsearch.sim.lift import (
    LiftConfig,
    LiftFrame,
    LiftWorld,
    Perturbation,
    above_table,
    perturbed,
)
from mechsearch.sim.scene import PhysicsConfig
from mechsearch.types import MechSearchError, Outcome


def at(x, y, z, yaw=0.0):
    return np.array([x, y, z, *yaw_quaternion(yaw)])


@pytest.fixture(scope="module")
def smalls(boxes):
    """Two 3 cm cubes of 50 g, for any grasp."""
    return LiftWorld([boxes.models["small0"], boxes.models["small1"]])


APART = np.array([at(0, 0, 0.015), at(0.15, 0, 0.015)])


def test_a_cube_between_the_fingers_is_lifted_and_survives_the_shake(smalls):
    assert smalls.lift(APART, 0, at(0, 0, 0.015)) is Outcome.SUCCESS
    assert smalls.lift(APART, 1, at(0.15, 0, 0.015, 1.57)) is Outcome.SUCCESS


def test_a_finger_that_lands_on_a_box_is_blocked(boxes):
    world = LiftWorld([boxes.models["cube"]])
    assert world.lift(np.array([at(0, 0, 0.03)]), 0, at(0, 0, 0.04)) is Outcome.BLOCKED


def test_a_box_just_narrower_than_the_opening_fits_and_a_wider_one_does_not(boxes):
    poses = np.array([at(0, 0, 0.03)])
    wide = LiftWorld([boxes.models["cube"]], Gripper(opening=0.066))
    assert wide.lift(poses, 0, at(0, 0, 0.045)) is Outcome.SUCCESS
    narrow = LiftWorld([boxes.models["cube"]], Gripper(opening=0.058))
    assert narrow.lift(poses, 0, at(0, 0, 0.045)) is Outcome.BLOCKED


def test_closing_on_air_is_a_miss(smalls):
    assert smalls.lift(APART, 0, at(0.07, 0, 0.015)) is Outcome.MISSED


def test_lifting_the_neighbour_is_the_wrong_object(smalls):
    assert smalls.lift(APART, 0, at(0.15, 0, 0.015)) is Outcome.WRONG_OBJECT


def test_what_rides_along_makes_two_objects(smalls):
    stacked = np.array([at(0, 0, 0.015), at(0, 0, 0.045)])
    assert smalls.lift(stacked, 0, at(0, 0, 0.016)) is Outcome.TWO_OBJECTS
    assert smalls.lift(stacked, 1, at(0, 0, 0.046)) is Outcome.SUCCESS


def test_two_cubes_squeezed_together_are_two_objects(boxes):
    world = LiftWorld([boxes.models["small0"], boxes.models["small1"]], Gripper(opening=0.075))
    beside = np.array([at(-0.0152, 0, 0.015), at(0.0152, 0, 0.015)])
    assert world.lift(beside, 0, at(0, 0, 0.015)) is Outcome.TWO_OBJECTS


def test_friction_decides_between_slipping_dropping_and_holding(smalls):
    # Two fingers of 20 N hold 50 g against gravity and the lift's 3.9 m/s^2 from a friction of
    # 0.017, and against a shake of 1 cm at 8 Hz (25 m/s^2) from 0.044.
    grasp = at(0, 0, 0.015)
    assert smalls.lift(APART, 0, grasp, friction=0.004) is Outcome.SLIPPED
    assert smalls.lift(APART, 0, grasp, friction=0.02) is Outcome.DROPPED
    assert smalls.lift(APART, 0, grasp, friction=0.1) is Outcome.SUCCESS


def test_the_fingers_stay_above_the_table(smalls):
    film: list[LiftFrame] = []
    assert smalls.lift(APART, 0, at(0, 0, -0.03), film=film) is Outcome.SUCCESS
    tips = [frame.gripper[1:, 2].min() - smalls.gripper.length / 2 for frame in film]
    assert 0.0 < min(tips) < 0.004


def test_a_tilted_grasp_is_drawn_back_along_its_own_approach():
    gripper = Gripper()
    tilt = np.array([0, 0, 0.005, np.cos(0.05), 0, np.sin(0.05), 0])
    raised = above_table(tilt, gripper)
    rotation = rotation_from_quaternion(tilt[3:])
    side = gripper.opening / 2 + gripper.thickness
    corner = [-side, gripper.width / 2, -gripper.reach], [side, 0, -gripper.reach]
    lowest = min((raised[:3] + rotation @ c)[2] for c in corner)
    assert lowest == pytest.approx(gripper.clearance, abs=1e-9)
    np.testing.assert_allclose(np.cross(raised[:3] - tilt[:3], rotation[:, 2]), 0, atol=1e-12)


def test_the_same_grasp_ends_the_same_whatever_came_before(smalls):
    def film_of():
        film: list[LiftFrame] = []
        smalls.lift(APART, 0, at(0.002, 0.004, 0.02, 0.3), film=film)
        return np.stack([frame.poses for frame in film])

    first = film_of()
    smalls.lift(APART, 1, at(0.15, 0, 0.02))
    np.testing.assert_array_equal(first, film_of())


def test_a_finer_time_step_agrees(boxes):
    fine = LiftConfig(physics=PhysicsConfig(time_step=0.001))
    models = [boxes.models["small0"], boxes.models["small1"]]
    coarse, exact = LiftWorld(models), LiftWorld(models, config=fine)
    rng = np.random.default_rng(3)
    same = 0
    for _ in range(20):
        grasp = at(*rng.uniform(-0.02, 0.02, 2), 0.018, rng.uniform(0, 3))
        same += coarse.lift(APART, 0, grasp) is exact.lift(APART, 0, grasp)
    assert same >= 18


def test_poses_of_other_objects_are_refused(smalls):
    with pytest.raises(MechSearchError, match=r"expected \(2, 7\)"):
        smalls.lift(np.zeros((3, 7)), 0, at(0, 0, 0))
    with pytest.raises(MechSearchError, match="0 to 1"):
        smalls.lift(APART, 2, at(0, 0, 0))
    with pytest.raises(MechSearchError, match=r"opens 0\.5 m"):
        Gripper(opening=0.5)


def test_perturbed_grasps_have_the_spread_that_was_asked_for():
    spread = Perturbation()
    rng = np.random.default_rng(0)
    draws = [perturbed(at(0.1, 0.2, 0.3, 0.7), rng, spread) for _ in range(4000)]
    poses = np.array([pose for pose, _ in draws])
    friction = np.array([value for _, value in draws])
    np.testing.assert_allclose(poses[:, :3].mean(axis=0), [0.1, 0.2, 0.3], atol=5e-4)
    np.testing.assert_allclose(poses[:, :3].std(axis=0), 0.005, rtol=0.05)
    angles = 2 * np.arccos(np.abs(poses[:, 3:] @ yaw_quaternion(0.7)))
    assert np.sqrt((angles**2).mean()) == pytest.approx(np.sqrt(3) * spread.rotation, rel=0.05)
    assert friction.mean() == pytest.approx(0.5, abs=0.01)
    assert friction.std() == pytest.approx(0.1, rel=0.05)
    assert 0.05 <= friction.min() < friction.max() <= 1.0
