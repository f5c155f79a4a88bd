from dataclasses import replace

import numpy as np
import pytest
import torch

from mechsearch.geometry import rotation_from_quaternion, yaw_quaternion
from mechsearch.grasp.grasp_scene import grasp_renderer, see_heap
from mechsearch.grasp.network import ready
from mechsearch.grasp.planner import GraspPlanner
from mechsearch.grasp.quality_network import (
    QualityNetwork,
    load_quality_network,
    mirrored,
    save_quality_network,
)
from mechsearch.grippers import (
    JAWS_GRID,
    SUCTION_GRID,
    RatedGrasps,
    aligned,
    gripper_named,
    height_map,
    propose_jaws,
    propose_suction,
    segment_view,
)
from mechsearch.sim.lift import LiftWorld
from mechsearch.types import MechSearchError, Outcome

JAWS = gripper_named("jaws-85")


def at(x, y, z, yaw=0.0):
    return [x, y, z, *yaw_quaternion(yaw)]


def view_of(models, poses, target=0):
    scene = see_heap(grasp_renderer(models), np.array(poses), target)
    return segment_view(scene.depth, scene.segments)


@pytest.fixture
def bar(make_box):
    return make_box("bar", (0.12, 0.04, 0.04))


@pytest.fixture
def planner(tmp_path):
    torch.manual_seed(0)
    path = tmp_path / "network.safetensors"
    save_quality_network(path, ready(QualityNetwork("jaws-85")), {})
    return GraspPlanner("jaws-85", path)


def test_segments_tell_target_others_and_table_apart(make_box):
    models = [make_box(name, (0.06, 0.06, 0.04)) for name in ("left", "right", "under")]
    poses = np.array([at(-0.1, 0, 0.02), at(0.1, 0, 0.06), at(0.1, 0, 0.02)])
    renderer = grasp_renderer(models)
    scene = see_heap(renderer, poses, 1)
    assert scene.depth.shape == scene.segments.shape == (512, 512)
    assert scene.objects[:2] == (1, 0)
    # Image columns run along x, rows along -y; 0.8 m is the table.
    row, column = 255, round(255.5 + 552.5 * 0.1 / (0.8 - 0.08))
    assert scene.segments[row, column] == 1
    assert scene.depth[row, column] == pytest.approx(0.72, abs=1e-4)
    assert scene.segments[row, round(255.5 - 552.5 * 0.1 / 0.76)] == 2
    assert scene.segments[10, 10] == 0
    hidden = see_heap(renderer, poses, 2)
    assert hidden.objects[0] == 2
    assert not segment_view(hidden.depth, hidden.segments).mask[row, column]


def test_heights_are_those_of_the_objects_wherever_they_are_in_view(make_box):
    models = [make_box("low", (0.06, 0.05, 0.03)), make_box("high", (0.04, 0.04, 0.12))]
    poses = [at(0.2, 0.15, 0.015), at(0.2, 0.09, 0.06)]
    heights = height_map(view_of(models, poses))
    x, y = np.array([0.2, 0.2, 0.2, 0.275]), np.array([0.15, 0.175 + 0.02, 0.09, 0.15])
    flat = heights.cells(x, y)
    np.testing.assert_allclose(heights.height.ravel()[flat], [0.03, 0, 0.12, 0], atol=1e-4)
    np.testing.assert_array_equal(heights.target.ravel()[flat], [True, False, False, False])
    area = heights.target.sum() * heights.cell**2
    assert area == pytest.approx(0.06 * 0.05, rel=0.1)
    far = heights.cells(np.array([9.0, -9.0]), np.array([9.0, -9.0]))
    np.testing.assert_array_equal(heights.height.ravel()[far], 0.0)


def test_a_hole_is_as_low_as_what_is_seen_around_it(make_box):
    view = view_of([make_box("low", (0.06, 0.06, 0.03))], [at(0, 0, 0.015)])
    whole, depth = height_map(view), view.depth.copy()
    # In the middle of the object, below the camera itself, and on the table.
    depth[250:260, 250:260] = depth[250:260, 330:340] = 0
    mask = view.mask & (depth > 0)
    np.testing.assert_array_equal(height_map(replace(view, depth=depth, mask=mask)).height,
                                  whole.height)  # fmt: skip


def test_the_aligned_patch_of_a_block_is_as_computed_by_hand(bar):
    # The bar is turned by 30 degrees, and the jaws close across it, 1 cm under its top.
    yaw = np.deg2rad(30)
    heights = height_map(view_of([bar], [at(0.05, 0.02, 0.02, yaw)]))
    pose = np.array([at(0.05, 0.02, 0.03, yaw + np.pi / 2)])
    seen = aligned(heights, pose, JAWS_GRID)
    u = (np.arange(64) - 31.5) * 0.002
    inside, outside = np.abs(u) < 0.017, np.abs(u) > 0.023
    np.testing.assert_allclose(seen.relative[0][:, inside], 0.01, atol=2e-4)
    np.testing.assert_allclose(seen.relative[0][:, outside], -0.03, atol=2e-4)
    assert seen.target[0][:, inside].all()
    assert not seen.target[0][:, outside].any()
    expected = [0.03, 0, 0, 0, 0, np.sqrt(0.12 * 0.04)]
    np.testing.assert_allclose(seen.numbers[0], expected, atol=2e-3)


def test_a_tilted_plane_is_flat_in_the_frame_of_its_own_normal(make_box):
    ramp = make_box("ramp", (0.1, 0.08, 0.04))
    tilt = np.deg2rad(20)
    pose = [0.05, 0.02, 0.06, np.cos(tilt / 2), 0.0, np.sin(tilt / 2), 0.0]
    heights = height_map(view_of([ramp], [pose]))
    top = np.array([0.05, 0.02, 0.06]) + 0.02 * rotation_from_quaternion(pose[3:])[:, 2]
    seen = aligned(heights, np.array([[*top, *pose[3:]]]), SUCTION_GRID)
    np.testing.assert_allclose(seen.relative[0, 6:-6, 6:-6], 0.0, atol=1.5e-3)
    np.testing.assert_allclose(seen.numbers[0, 1:3], [-np.sin(tilt), 0], atol=1e-6)


def test_jaws_are_proposed_across_a_bar_deep_and_apart_and_nearly_all_lift_it(bar):
    poses = [at(0.15, -0.1, 0.02)]
    heights = height_map(view_of([bar], poses))
    found = propose_jaws(heights, np.random.default_rng(0), 60, gripper_named("jaws-56"), 0.0)
    assert len(found) == 60
    closing = rotation_from_quaternion(found[:, 3:])[:, :, 0]
    # The bar lies along x, so fingers close along y, within the friction cone and a cell.
    assert (np.abs(closing[:, 1]) > np.cos(np.deg2rad(35))).all()
    assert np.abs(found[:, 1] + 0.1).max() < 0.003
    # Tips are 1 cm beyond the grasp centre, at least 2 mm over the table and 6 mm under the top.
    tips = found[:, 2] - 0.01
    assert tips.min() == pytest.approx(0.002, abs=1e-6)
    assert tips.max() < 0.034
    assert len(np.unique(np.round(found, 9), axis=0)) == 60
    world = LiftWorld([bar])
    won = [world.lift(np.array(poses), 0, pose) is Outcome.SUCCESS for pose in found[:20]]
    assert np.mean(won) > 0.8


def test_jaws_are_not_proposed_where_no_finger_fits(bar, make_box):
    walls = [make_box(f"wall{i}", (0.16, 0.05, 0.04)) for i in range(2)]
    ends = [make_box(f"end{i}", (0.05, 0.2, 0.04)) for i in range(2)]
    poses = [
        at(0, 0, 0.02), at(0, 0.047, 0.02), at(0, -0.047, 0.02), at(0.09, 0, 0.02),
        at(-0.09, 0, 0.02),
    ]  # fmt: skip
    heights = height_map(view_of([bar, *walls, *ends], poses))
    assert len(propose_jaws(heights, np.random.default_rng(0), 60, JAWS, 0.0)) == 0
    # Fingers may still push the walls aside.
    assert len(propose_jaws(heights, np.random.default_rng(0), 60, JAWS)) == 60
    wide = height_map(view_of([make_box("wide", (0.1, 0.1, 0.05))], [at(0, 0, 0.025)]))
    assert len(propose_jaws(wide, np.random.default_rng(0), 60, JAWS)) == 0
    cube = height_map(view_of([make_box("cube", (0.07, 0.07, 0.05))], [at(0, 0, 0.025)]))
    assert len(propose_jaws(cube, np.random.default_rng(0), 60, gripper_named("jaws-56"))) == 0
    assert len(propose_jaws(cube, np.random.default_rng(0), 60, JAWS)) > 10


def test_a_cup_is_never_proposed_on_an_edge_and_stands_upright_on_what_it_is_put_on(bar):
    heights = height_map(view_of([bar], [at(0.15, -0.1, 0.02)]))
    found = propose_suction(heights, np.random.default_rng(0), 80, 0.01)
    assert len(found) == 80
    # The lip's radius is 1 cm, and a cell is 2 mm.
    assert np.abs(found[:, 0] - 0.15).max() < 0.06 - 0.01 + 0.002
    assert np.abs(found[:, 1] + 0.1).max() < 0.02 - 0.01 + 0.002
    np.testing.assert_allclose(found[:, 2], 0.04, atol=1e-4)
    np.testing.assert_allclose(found[:, 3], 1.0, atol=1e-4)


def test_a_cup_points_along_the_normal_of_a_slope_and_nowhere_too_steep(make_box):
    ramp = make_box("ramp", (0.12, 0.1, 0.04))
    for degrees, expected in ((25, 60), (60, 0)):
        tilt = np.deg2rad(degrees)
        pose = [0.0, 0.0, 0.08, np.cos(tilt / 2), 0.0, np.sin(tilt / 2), 0.0]
        heights = height_map(view_of([ramp], [pose]))
        found = propose_suction(heights, np.random.default_rng(0), 60, 0.01)
        if not expected:
            upright = rotation_from_quaternion(found[:, 3:])[:, 2, 2]
            assert (upright > np.cos(np.deg2rad(45))).all()
            continue
        normal = rotation_from_quaternion(found[:, 3:])[:, :, 2]
        wanted = [np.sin(tilt), 0, np.cos(tilt)]
        assert len(found) == expected
        np.testing.assert_allclose(np.median(normal, axis=0), wanted, atol=0.02)


def test_a_plan_depends_on_view_and_draws_alone_and_has_the_best_first(planner, bar):
    view = view_of([bar], [at(0, 0, 0.02)])
    one, two = (planner.plan(view, np.random.default_rng(3), 40) for _ in range(2))
    np.testing.assert_array_equal(one.poses, two.poses)
    np.testing.assert_array_equal(one.quality, two.quality)
    assert (np.diff(one.quality) <= 0).all()
    assert len(one) == 40
    assert ((one.quality >= 0) & (one.quality <= 1)).all()


def test_a_drawn_grasp_closes_across_the_target(planner, bar):
    pose = planner.drawn(view_of([bar], [at(0, 0, 0.02)]), np.random.default_rng(0))
    assert abs(rotation_from_quaternion(pose[3:])[1, 0]) > np.cos(np.deg2rad(35))
    assert abs(pose[1]) < 0.003


def test_nothing_is_planned_on_a_target_that_is_hidden(planner, bar, make_box):
    lid = make_box("lid", (0.3, 0.3, 0.02))
    hidden = view_of([bar, lid], [at(0, 0, 0.02), at(0, 0, 0.05)])
    plan = planner.plan(hidden, np.random.default_rng(0))
    assert planner.drawn(hidden, np.random.default_rng(0)) is None
    assert len(plan) == 0
    assert plan.poses.shape == (0, 7)


def test_the_best_grasps_apart_are_apart():
    poses = np.array([at(0, 0, 0), at(0.005, 0, 0), at(0.005, 0, 0, 0.8), at(0.02, 0, 0)])
    found = RatedGrasps(poses, np.array([0.9, 0.8, 0.7, 0.6])).apart(3)
    np.testing.assert_array_equal(found.quality, [0.9, 0.7, 0.6])


def test_a_network_of_another_gripper_is_refused(tmp_path):
    path = tmp_path / "network.safetensors"
    save_quality_network(path, ready(QualityNetwork("jaws-56")), {})
    with pytest.raises(MechSearchError, match="of the gripper 'jaws-56'; expected 'jaws-85'"):
        load_quality_network("jaws-85", path)
    with pytest.raises(MechSearchError, match="unknown gripper 'tongs'"):
        GraspPlanner("tongs", path)
    with pytest.raises(MechSearchError, match="no mechsearch grasp quality network at"):
        GraspPlanner("jaws-56", tmp_path / "absent.safetensors")


@pytest.mark.parametrize("symmetry", range(8))
def test_a_mirrored_patch_is_the_patch_of_the_mirrored_scene(symmetry):
    rng = np.random.default_rng(0)
    spots, middle, up = rng.uniform(-0.03, 0.03, (5, 2)), rng.random(2), rng.random(2)

    def drawn(points, middle, up):
        image = np.zeros((1, 32, 32), np.float32)
        column, row = np.round(points / 0.002 + 15.5).astype(int).T
        image[0, row, column] = np.arange(1, 6)
        return image, image > 0, np.array([[0.1, *up, *middle, 0.2]], np.float32)

    def turned(vector):
        x, y = vector[..., 0].copy(), vector[..., 1].copy()
        x, y = (-x if symmetry & 1 else x), (-y if symmetry & 2 else y)
        return np.stack([y, x] if symmetry & 4 else [x, y], axis=-1)

    # Spots in the middles of cells, so that mirroring moves none to another cell.
    spots = (np.floor(spots / 0.002) + 0.5) * 0.002
    found = mirrored(*drawn(spots, middle, up), np.array([symmetry]))
    for got, wanted in zip(found, drawn(turned(spots), turned(middle), turned(up)), strict=True):
        np.testing.assert_array_equal(got, wanted)


def test_no_finger_is_sent_down_on_the_target_itself(make_box):
    plate = make_box("plate", (0.14, 0.05, 0.05))
    found = propose_jaws(
        height_map(view_of([plate], [at(0, 0, 0.025)])), np.random.default_rng(0), 60, JAWS
    )
    closing = rotation_from_quaternion(found[:, 3:])[:, :, 0]
    for side in (-1, 1):
        tips = found[:, :2] + side * (JAWS.opening + JAWS.thickness) / 2 * closing[:, :2]
        assert (np.abs(tips) > [0.068, 0.023]).any(axis=1).all()
