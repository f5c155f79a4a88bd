import numpy as np
import pytest

from mechsearch.grasp.grasp_scene import view_of_heap
from mechsearch.grasp.proposals import antipodal, uniform
from mechsearch.grippers import Gripper, angle_bin, depth_bins
from mechsearch.sim.lift import LiftWorld
from mechsearch.types import Outcome


def at(x, y, z):
    return [x, y, z, 1.0, 0.0, 0.0, 0.0]


@pytest.fixture
def bar(make_box):
    return make_box("bar", (0.12, 0.03, 0.04))


def test_uniform_grasps_cover_the_visible_target_and_the_policys_bins(bar):
    view = view_of_heap([bar], np.array([at(0, 0, 0.02)]), 0)
    grasps = uniform(view, np.random.default_rng(0), 4000)
    assert all(view.mask[int(g.row), int(g.column)] for g in grasps)
    bins = [int(angle_bin(g.angle)) for g in grasps]
    assert np.bincount(bins, minlength=16).min() > 170
    near, far = float(view.depth[view.mask].min()), view.far
    assert {round(g.depth, 9) for g in grasps} == {round(d, 9) for d in depth_bins(near, far)}


def test_antipodal_grasps_close_across_a_bar_and_nearly_all_lift_it(bar):
    poses = np.array([at(0, 0, 0.02)])
    view = view_of_heap([bar], poses, 0)
    gripper = Gripper()
    grasps = antipodal(view, np.random.default_rng(0), 20, gripper)
    assert len(grasps) == 20
    # The bar lies along x, so fingers close along y; 30 degrees is friction 0.5 and rounding.
    assert all(abs(np.sin(g.angle)) > np.cos(np.deg2rad(32)) for g in grasps)
    world = LiftWorld([bar], gripper)
    won = [world.lift(poses, 0, g.pose(view.camera)) is Outcome.SUCCESS for g in grasps]
    assert np.mean(won) > 0.8
    chance = uniform(view, np.random.default_rng(0), 60)
    by_chance = [world.lift(poses, 0, g.pose(view.camera)) is Outcome.SUCCESS for g in chance]
    assert np.mean(by_chance) < np.mean(won) / 2


def test_nothing_is_proposed_where_no_finger_fits(bar, make_box):
    walls = [make_box(f"wall{i}", (0.14, 0.05, 0.04)) for i in range(2)]
    poses = np.array([at(0, 0, 0.02), at(0, 0.042, 0.02), at(0, -0.042, 0.02)])
    view = view_of_heap([bar, *walls], poses, 0)
    assert antipodal(view, np.random.default_rng(0), 10, Gripper()) == []
    cube = make_box("wide", (0.1, 0.1, 0.05))
    wide = view_of_heap([cube], np.array([at(0, 0, 0.025)]), 0)
    found = antipodal(wide, np.random.default_rng(0), 10, Gripper())
    assert found == []
