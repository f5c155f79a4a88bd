import numpy as np
import pytest

from mechsearch.geometry import yaw_quaternion
from mechsearch.grippers import GRIPPERS, Gripper, SuctionCup, gripper_named
from mechsearch.objects.model import ObjectModel
from mechsearch.sim.gripper_world import GripperWorld
from mechsearch.sim.lift import LiftFrame
from mechsearch.sim.suction import holds, seal_of
from mechsearch.types import MechSearchError, Outcome


def at(x, y, z, yaw=0.0):
    return np.array([x, y, z, *yaw_quaternion(yaw)])


APART = np.array([at(0, 0, 0.015), at(0.15, 0, 0.015)])
CORNER = np.array([0.25, 0.25, 0.2])


@pytest.fixture(scope="module")
def smalls(boxes):
    """Two 3 cm cubes of 50 g, for jaws of 85 mm and a suction cup."""
    models = [boxes.models["small0"], boxes.models["small1"]]
    return GripperWorld(models, [GRIPPERS["jaws-85"], GRIPPERS["suction"]])


@pytest.mark.parametrize(("gripper", "height"), [(0, 0.015), (1, 0.03)])
def test_what_is_grasped_comes_up_and_is_put_back_where_it_was(smalls, gripper, height):
    film: list[LiftFrame] = []
    smalls.reset(APART, CORNER)
    attempt = smalls.attempt(0, at(0, 0, height, 0.3), gripper, film=film)
    assert (attempt.outcome, attempt.held) == (Outcome.SUCCESS, (0,))
    assert smalls.poses[0, 2] > 0.19
    smalls.release(film)
    smalls.settle()
    np.testing.assert_allclose(smalls.poses[:, :3], APART[:, :3], atol=0.004)
    assert {"descend", "lift", "lower", "open", "leave"} <= {frame.phase for frame in film}


def test_what_is_stowed_is_gone_and_the_rest_lies_as_it_lay(smalls):
    smalls.reset(APART, CORNER)
    assert smalls.attempt(1, at(0.15, 0, 0.015)).held == (1,)
    smalls.stow()
    smalls.settle()
    assert smalls.workspace.off_table(smalls.poses).tolist() == [False, True]
    np.testing.assert_allclose(smalls.poses[0], APART[0], atol=1e-3)


def test_the_neighbour_comes_up_as_the_wrong_object(smalls):
    for gripper, height in ((0, 0.015), (1, 0.03)):
        smalls.reset(APART, CORNER)
        attempt = smalls.attempt(0, at(0.15, 0, height), gripper)
        assert (attempt.outcome, attempt.held) == (Outcome.WRONG_OBJECT, (1,))
        smalls.release()


def test_a_snapshot_between_decisions_has_all_that_follows(smalls, boxes):
    def go_on():
        smalls.push(np.array([0.05, 0.0, 0.03]))
        outcomes = []
        for gripper, grasp in ((0, at(0, 0, 0.015, 0.7)), (1, at(0.15, 0, 0.03))):
            outcomes.append(smalls.attempt(0, grasp, gripper, friction=0.4).outcome)
            smalls.release()
            smalls.settle()
        return [*map(str, outcomes), smalls.poses.tobytes(), smalls.pusher_position.tobytes()]

    smalls.reset(APART, np.array([-0.1, 0.0, 0.03]))
    smalls.push(np.array([-0.05, 0.0, 0.03]))
    kept = smalls.snapshot()
    first = go_on()
    smalls.restore(kept)
    assert go_on() == first
    # Another world, without that past, goes on alike.
    fresh = GripperWorld([boxes.models["small0"], boxes.models["small1"]], smalls.grippers)
    fresh.restore(kept)
    smalls = fresh
    assert go_on() == first


def test_closed_jaws_push_what_stands_in_their_way(boxes):
    world = GripperWorld([boxes.models["small0"]], [GRIPPERS["jaws-56"]])
    world.reset(np.array([at(0, 0, 0.015)]), np.array([-0.06, 0.0, 0.02]))
    assert world.pusher_is_free()
    assert world.push(np.array([-0.01, 0.0, 0.02]))
    # The fingers are 8 mm thick each: its face makes way for them, and it slides on a little.
    assert -0.002 < world.poses[0, 0] - 0.015 < 0.04
    # From 3 cm above it, nothing has to be simulated.
    world.reset(np.array([at(0, 0, 0.015)]), np.array([-0.06, 0.0, 0.1]))
    assert not world.push(np.array([-0.01, 0.0, 0.1]))
    np.testing.assert_allclose(world.pusher_position, [-0.01, 0.0, 0.1])


def test_bad_input_is_named(smalls):
    smalls.reset(APART, CORNER)
    with pytest.raises(MechSearchError, match="holds nothing"):
        smalls.release()
    with pytest.raises(MechSearchError, match="target 2 and gripper 0; expected 0 to 1"):
        smalls.attempt(2, at(0, 0, 0.015))
    smalls.attempt(0, at(0, 0, 0.015))
    with pytest.raises(MechSearchError, match="release or stow it first"):
        smalls.attempt(0, at(0, 0, 0.015))
    with pytest.raises(MechSearchError, match="without a gripper"):
        GripperWorld([], [])
    with pytest.raises(MechSearchError, match="unknown gripper 'jaws'; choose one of jaws-56"):
        gripper_named("jaws")
    assert gripper_named("jaws-56") == Gripper()


@pytest.mark.parametrize(
    ("load", "bears"),
    [
        # 80 kPa on a lip of 10 mm hold 25.13 N.
        ([0, 0, -25.1, 0, 0, 0], True),
        ([0, 0, -25.2, 0, 0, 0], False),
        ([0, 0, 4.0, 0.29, 0, 0], True),
        ([0, 0, 4.0, 0.292, 0, 0], False),
        ([0, 0, -15.13, 0.099, 0, 0], True),
        ([0, 0, -15.13, 0, 0.101, 0], False),
        ([4.9, 0, -15.13, 0, 0, 0], True),
        ([3.6, 3.6, -15.13, 0, 0, 0], False),
        ([0, 0, -15.13, 0, 0, 0.051], False),
    ],
)
def test_a_seal_bears_what_vacuum_lip_and_friction_bear(load, bears):
    assert holds(SuctionCup(), np.array(load, np.float64)) is bears


def test_a_seal_needs_a_flat_surface_all_around_the_lip(boxes):
    cup, cube, pose = SuctionCup(), boxes.models["cube"], at(0, 0, 0.03)
    assert seal_of(cup, at(0, 0, 0.06), cube, pose)
    assert seal_of(cup, at(0.019, 0.019, 0.06), cube, pose)
    assert not seal_of(cup, at(0.0201, 0, 0.06), cube, pose), "the lip stands over the edge"
    assert not seal_of(cup, at(0, 0, 0.07), cube, pose), "1 cm is beyond the bellows' stroke"
    for degrees, sealed in ((19, True), (21, False)):
        half = np.deg2rad(degrees) / 2
        tilted = np.array([0, 0, 0.06, np.cos(half), np.sin(half), 0, 0])
        assert seal_of(cup, tilted, cube, pose) is sealed


@pytest.mark.parametrize(("radius", "sealed"), [(0.016, False), (0.04, True)])
def test_a_ball_is_sealed_where_the_whole_lip_lies_on_it(radius, sealed):
    """A sphere meets the lip in a circle: no point of it is off the plane, whatever the radius."""
    import trimesh

    ball = trimesh.creation.icosphere(3, radius)
    model = ObjectModel(
        "ball", "toy", np.array(ball.vertices), np.array(ball.faces, np.int32),
        np.zeros((len(ball.faces), 1, 3), np.uint8), (np.array(ball.vertices),), 0.05,
        np.eye(3) * 1e-5, 0.5, 0.0, "",
    )  # fmt: skip
    off = at(0.008, 0, radius)
    assert seal_of(SuctionCup(), off, model, at(0, 0, 0)) is sealed
