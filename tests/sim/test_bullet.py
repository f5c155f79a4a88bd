"""The same scene in PyBullet; `tests/benchmarks/test_peer.py` pushes in both engines."""

import numpy as np
import pytest

from mechsearch.sim import PhysicsConfig, Pusher

pybullet = pytest.importorskip("pybullet", reason="the extra bullet is not installed")
from mechsearch.sim.bullet import RATE, BulletWorld  # noqa: E402

REST = np.array([[0, 0, 0.03, 1, 0, 0, 0]])


@pytest.fixture
def cube(boxes):
    return [boxes.models["cube"]]


def above(height, x=0.0):
    return np.array([[x, 0, 0.03 + height, 1, 0, 0, 0]])


def test_free_fall_follows_newton_and_ends_at_rest_on_the_table(cube):
    world = BulletWorld(cube)
    world.reset(above(1.0))
    world.step(RATE // 4)
    assert world.poses[0, 2] == pytest.approx(1.03 - 9.81 * 0.25**2 / 2, abs=0.01)
    assert world.settled(above(0.1))[0, 2] == pytest.approx(0.03, abs=0.001)


def test_an_object_at_rest_stays(boxes):
    poses = np.array([[0, 0, 0.03, 1, 0, 0, 0], [0.025, 0, 0.07, 1, 0, 0, 0]])
    world = BulletWorld([boxes.models["cube"], boxes.models["lid"]], pusher=Pusher())
    settled = world.settled(poses)
    # Bullet keeps a margin of 1 mm about every convex part.
    np.testing.assert_allclose(settled[:, :3], poses[:, :3], atol=0.004)
    world.reset(settled, np.array([0.2, 0.2, 0.1]))
    for _ in range(5):
        world.push(world.pusher_position)
    np.testing.assert_allclose(world.poses, settled, atol=0.001)
    assert world.failure() is None


def test_friction_on_the_table_brakes_as_in_mujoco(cube):
    world = BulletWorld(cube)
    world.reset(world.settled(REST))
    pybullet.resetBaseVelocity(world.bodies[0], [0.5, 0, 0], physicsClientId=world.client)
    world.step(RATE)
    # The larger of 0.5 and 0.6 counts.
    assert world.poses[0, 0] == pytest.approx(0.5**2 / (2 * 0.6 * 9.81), rel=0.1)


def test_what_does_not_come_to_rest_is_told_with_the_reason(cube):
    world = BulletWorld(cube)
    for pose, why in ((above(0, 0.5), "cube left the table"), (above(100), "it keeps moving")):
        with pytest.raises(RuntimeError, match=f"does not come to rest in Bullet: {why}"):
            world.settled(pose)


def test_what_follows_a_reset_depends_on_the_poses_alone(boxes, covered):
    models = [boxes.models[name] for name in covered.objects]

    def pushed(world):
        world.reset(world.settled(covered.poses), np.array([-0.1, 0.0, 0.06]))
        for _ in range(4):
            world.push(world.pusher_position + np.array([0.05, 0.0, 0.0]))
        return world.poses

    world = BulletWorld(models, pusher=Pusher())
    once, again, anew = pushed(world), pushed(world), pushed(BulletWorld(models, pusher=Pusher()))
    assert np.abs(once - covered.poses).max() > 0.02
    assert once.tobytes() == again.tobytes() == anew.tobytes()


def test_an_action_lasts_as_long_as_in_mujoco(cube):
    given, own = PhysicsConfig(), BulletWorld(cube).config
    for name in ("action_steps", "rest_steps"):
        seconds = getattr(given, name) * given.time_step
        assert getattr(own, name) * own.time_step == pytest.approx(seconds, abs=0.5 / RATE)


def test_failures_have_names(cube):
    world = BulletWorld(cube, pusher=Pusher())
    world.reset(REST, np.array([0.0, 0.0, 0.03]))
    assert not world.pusher_is_free()
    world.step(1)
    assert world.failure() == "deep penetration"
    world.reset(above(-0.1))
    assert world.pusher_is_free()
    assert world.failure() == "tunnelling"
    world.reset(REST)
    assert world.failure() is None
    pybullet.resetBaseVelocity(world.bodies[0], [0, 0, 9.0], physicsClientId=world.client)
    assert world.failure() == "explosion"
