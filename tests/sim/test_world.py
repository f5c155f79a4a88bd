import subprocess
import sys

import numpy as np
import pytest
import trimesh

from mechsearch.sim.scene import PhysicsConfig, Pusher, Wall, Workspace, pusher_model
from mechsearch.sim.world import AWAKE, REST_LIMIT, World, drift, settle

REST = [0, 0, 0.03, 1, 0, 0, 0]


@pytest.fixture
def cube(boxes):
    return [boxes.models["cube"]]


def test_free_fall_follows_newton(cube):
    world = World(cube)
    world.reset(np.array([[0, 0, 2.0, 1, 0, 0, 0]]))
    steps = 60
    world.step(steps)
    seconds = steps * world.config.time_step
    assert world.poses[0, 2] == pytest.approx(2.0 - 9.81 * seconds**2 / 2, abs=0.01)


def test_a_cube_at_rest_stays(cube):
    assert drift(cube, np.array([REST])) < REST_LIMIT / 5


def test_an_unsupported_cube_is_not_at_rest(cube):
    assert drift(cube, np.array([[0, 0, 0.1, 1, 0, 0, 0]])) > REST_LIMIT


def test_settling_reports_whether_everything_stopped(cube):
    world = World(cube, config=AWAKE)
    world.reset(np.array([[0, 0, 0.1, 1, 0, 0, 0]]))
    assert not settle(world, seconds=0.25)
    assert settle(world)
    assert world.poses[0, 2] == pytest.approx(0.03, abs=1e-3)


def test_every_action_lasts_the_same_time(cube):
    world = World(cube, pusher=Pusher())
    world.reset(np.array([REST]), np.array([0.2, 0.2, 0.1]))
    times = []
    for target in ([0.2, 0.2, 0.1], [0.25, 0.2, 0.1], [0.25, 0.21, 0.1]):
        before = world._data.time
        world.push(np.array(target))
        times.append(world._data.time - before)
    config = PhysicsConfig()
    expected = (config.action_steps + config.rest_steps) * config.time_step
    np.testing.assert_allclose(times, expected, atol=1e-9)


def test_the_pusher_shoves_a_light_cube_and_its_force_is_limited(boxes, cube):
    world = World(cube, pusher=Pusher())
    world.reset(np.array([REST]), np.array([-0.06, 0, 0.03]))
    for _ in range(3):
        world.push(world.pusher_position + np.array([0.05, 0, 0]))
    assert world.poses[0, 0] > 0.05
    heavy = [boxes.models["plate"]]
    weak = World(heavy, pusher=Pusher(force=0.1))
    weak.reset(np.array([[0, 0, 0.01, 1, 0, 0, 0]]), np.array([-0.08, 0, 0.011]))
    for _ in range(4):
        weak.push(weak.pusher_position + np.array([0.05, 0, 0]))
    assert abs(weak.poses[0, 0]) < 2e-3


def test_a_snapshot_is_exact_even_in_another_world_of_the_same_objects(boxes):
    models = list(boxes.models.values())
    poses = np.array([[0.02 * i, 0, 0.05 + 0.07 * i, 1, 0, 0, 0] for i in range(len(models))])
    one, other = World(models, pusher=Pusher()), World(models, pusher=Pusher())
    one.reset(poses, np.array([-0.2, 0, 0.05]))
    one.step(57)
    snapshot = one.snapshot()
    one.push(np.array([-0.15, 0, 0.05]))
    other.restore(snapshot)
    other.push(np.array([-0.15, 0, 0.05]))
    np.testing.assert_array_equal(one.snapshot(), other.snapshot())


def test_a_wall_confines_and_can_be_removed(cube):
    world = World(cube, walls=[Wall(0, 0, 0.06)])
    world.reset(np.array([REST]))
    world._data.qvel[0] = 1.0
    world.step(100)
    assert world.poses[0, 0] < 0.04
    world.remove_walls()
    world._data.qvel[0] = 1.0
    world.step(100)
    assert world.poses[0, 0] > 0.06


def test_explosions_are_named(cube):
    world = World(cube)
    world.reset(np.array([[0, 0, 0.1, 1, 0, 0, 0]]))
    assert world.failure() is None
    world._data.qvel[2] = 20.0
    assert world.failure() == "explosion"


def test_the_workspace_clips_and_knows_what_left_the_table():
    workspace = Workspace()
    np.testing.assert_allclose(workspace.clip([1, -1, -1]), [0.3, -0.3, 0.01])
    assert workspace.off_table(np.array([0.41, 0, 0.1]))
    assert workspace.off_table(np.array([0.0, 0, -0.1]))
    assert not workspace.off_table(np.array([0.39, -0.39, 0.02]))


def test_the_pushers_mesh_is_closed_and_starts_at_its_tip():
    model = pusher_model(Pusher())
    mesh = trimesh.Trimesh(model.vertices, model.faces)
    assert mesh.is_watertight
    assert mesh.volume > 0
    np.testing.assert_allclose(mesh.bounds[:, 2], [0, Pusher().length], atol=1e-9)


OTHER_USER = """
import os, sys
import mujoco, numpy as np
told = []
mujoco.set_mju_user_warning(told.append)
import mechsearch, mechsearch.sim.lift, mechsearch.sim.world
from mechsearch.objects.household.object_set import household

world = mechsearch.sim.world.World([household().models["mug"]])
pose = np.array([[0.0, 0.0, np.nan, 1.0, 0.0, 0.0, 0.0]])
for _ in range(2):
    world.reset(pose)
    before = world.snapshot()
    world.step(3)
    assert world.failure() == "not a number" and world._warnings.max() > 1
    world.restore(before)
    world.step(3)
assert not told and not os.path.exists("MUJOCO_LOG.TXT"), told

model = mujoco.MjModel.from_xml_string(
    "<mujoco><worldbody><body><freejoint/><geom size='0.1'/></body></worldbody></mujoco>"
)
data = mujoco.MjData(model)
data.qpos[0] = np.nan
mujoco.mj_step(model, data)
assert told, "the other user of the engine is not warned"
"""


def test_warnings_of_our_worlds_are_counted_and_those_of_other_users_reach_them(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", OTHER_USER], cwd=tmp_path, capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")
