import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mechsearch.camera import Camera, preset
from mechsearch.geometry import random_quaternion, yaw_quaternion
from mechsearch.render.renderer import Renderer
from mechsearch.render.visibility import Projection, body_of, occlusion

CAMERA = preset("overhead")


def at(x, y, z):
    return [x, y, z, 1.0, 0.0, 0.0, 0.0]


def hidden(boxes, names, poses, target=0, **options):
    bodies = [body_of(boxes.models[n]) for n in names]
    return occlusion(bodies, CAMERA, np.array(poses), target, **options)


def tumbled(boxes, rng, reach=0.08):
    """Return poses that send all boxes through each other, above the table, turned any way."""
    return np.array(
        [
            [*rng.uniform(-reach, reach, 2), rng.uniform(0.08, 0.25), *random_quaternion(rng)]
            for _ in boxes.models
        ]
    )


def test_occlusion_is_zero_when_target_is_alone(boxes):
    assert hidden(boxes, ["cube"], [at(0.1, 0, 0.03)]) == 0.0


def test_occlusion_is_one_under_a_larger_plate(boxes):
    assert hidden(boxes, ["small0", "plate"], [at(0, 0, 0.015), at(0, 0, 0.04)]) == 1.0


def test_what_lies_at_the_very_same_distance_hides_nothing(boxes):
    assert hidden(boxes, ["small0", "small1"], [at(0, 0, 0.015), at(0, 0, 0.015)]) == 0.0


def test_half_a_cover_hides_half(boxes):
    """Seen from 1 m, the edge of a plate 4 cm up lies over the middle of a cube 3 cm high."""
    measured = hidden(boxes, ["small0", "plate"], [at(0, 0, 0.015), at(0.05, 0, 0.04)])
    assert measured == pytest.approx(0.5, abs=0.04)


def test_an_object_below_hides_nothing(boxes):
    assert hidden(boxes, ["small0", "plate"], [at(0, 0, 0.06), at(0, 0, 0.01)]) == 0.0


def test_projection_beyond_the_frame_counts(boxes):
    """The cube's projection spans 0.333 to 0.374 m on the table, and the image ends at 0.348 m.

    The plate's outer edge, 5 cm up at 0.336 m, projects to the middle of that span: in the frame
    alone everything would be hidden, in truth half is.
    """
    poses = [at(0.348, 0, 0.015), at(0.286, 0, 0.04)]
    assert hidden(boxes, ["small0", "plate"], poses) == pytest.approx(0.5, abs=0.05)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_permuting_the_objects_changes_nothing(boxes, seed):
    rng = np.random.default_rng(seed)
    names = list(boxes.models)
    poses = np.array([at(*rng.uniform(-0.06, 0.06, 2), rng.uniform(0.02, 0.2)) for _ in names])
    order = rng.permutation(len(names))
    target = int(rng.integers(len(names)))
    before = hidden(boxes, names, poses, target)
    after = hidden(boxes, [names[i] for i in order], poses[order], int(np.argsort(order)[target]))
    assert before == after
    assert 0.0 <= before <= 1.0


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["overhead", "tilted"]))
def test_occlusion_is_the_share_of_pixels_that_a_dense_frame_hides(boxes, seed, view):
    rng = np.random.default_rng(seed)
    poses, target = tumbled(boxes, rng), int(rng.integers(len(boxes.models)))
    bodies = [body_of(model) for model in boxes.models.values()]
    frame = Renderer(list(boxes.models.values())).frame(preset(view, 256), poses)
    whole, seen = frame.amodal[target], frame.modal(target)
    assert not (seen & ~whole).any()
    measured = occlusion(bodies, preset(view), poses, target)
    assert measured == pytest.approx(1 - seen.sum() / whole.sum(), abs=1e-12)


def test_a_projection_notices_a_body_that_slid_before_one_that_also_turned(boxes):
    rng = np.random.default_rng(1)
    names, poses = list(boxes.models), tumbled(boxes, rng)
    kept = Projection(CAMERA, [body_of(boxes.models[n]) for n in names])
    kept.place(poses)
    moved = poses.copy()
    moved[1, 0] += 0.05
    moved[3] = tumbled(boxes, rng)[3]
    assert (moved[3] != poses[3]).all()
    kept.place(moved)
    new = Projection(CAMERA, [body_of(boxes.models[n]) for n in names])
    new.place(moved)
    np.testing.assert_array_equal(kept.starts, new.starts)
    np.testing.assert_array_equal(kept.bounds, new.bounds)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_projection_that_follows_the_objects_is_as_good_as_a_new_one(boxes, seed):
    rng = np.random.default_rng(seed)
    names, poses = list(boxes.models), tumbled(boxes, rng)
    kept = Projection(CAMERA, [body_of(boxes.models[n]) for n in names])
    for _ in range(8):
        index, turn = rng.integers(len(names)), rng.integers(4)
        if rng.random() < 0.5:
            poses[index, :3] += rng.normal(0, 0.02, 3)
        if turn == 1:
            poses[index, 3:] = random_quaternion(rng)
        elif turn == 2:
            poses[index, 3:] = yaw_quaternion(rng.uniform(0, 6))
        elif turn == 3:
            poses[index, 3] *= -1
        target = int(rng.integers(len(names)))
        kept.place(poses)
        followed = hidden(boxes, names, poses, target, projection=kept)
        assert followed == hidden(boxes, names, poses, target)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_what_is_absent_hides_nothing(boxes, seed):
    rng = np.random.default_rng(seed)
    names, poses = list(boxes.models), tumbled(boxes, rng, 0.04)
    present = rng.random(len(names)) < 0.5
    present[0] = True
    measured = hidden(boxes, names, poses, 0, present=present)
    left = np.flatnonzero(present)
    assert measured == hidden(boxes, [names[i] for i in left], poses[left])
    assert measured <= hidden(boxes, names, poses, 0)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_target_hidden_beyond_the_frame_is_hidden_as_it_would_be_within(boxes, seed):
    """Under a camera that is moved along with a scene, nothing changes but the frame's edges."""
    rng = np.random.default_rng(seed)
    names, poses = list(boxes.models), tumbled(boxes, rng, 0.06)
    wide = Camera(192, 192, CAMERA.fx, CAMERA.fy, 95.5, 95.5, CAMERA.world_from_camera)
    poses[:, :2] += rng.uniform(-0.5, 0.5, 2)
    bodies = [body_of(boxes.models[n]) for n in names]
    assert occlusion(bodies, CAMERA, poses, 0) == occlusion(bodies, wide, poses, 0)


def test_a_splinter_before_the_lens_hides_everything(boxes, make_box):
    """From 1.5 mm its end of 2 mm fills the view; a little farther off it would not."""
    bodies = [body_of(boxes.models["small0"]), body_of(make_box("splinter", (0.002, 0.002, 0.03)))]
    for z, share in ((0.9835, 1.0), (0.95, 0.0)):
        poses = np.array([at(0.25, 0, 0.015), at(0, 0, z)])
        assert occlusion(bodies, CAMERA, poses, 0) == share


def test_a_target_too_thin_for_any_ray_counts_as_hidden(make_box):
    grain = body_of(make_box("grain", (1e-5, 1e-5, 1e-5)))
    assert occlusion([grain], CAMERA, np.array([at(0.0017, 0.0017, 0)]), 0) == 1.0


def test_a_denser_bundle_of_rays_measures_the_same_share_more_finely(boxes):
    bodies = [body_of(model) for model in boxes.models.values()]
    poses = tumbled(boxes, np.random.default_rng(1), 0.04)
    found = [occlusion(bodies, CAMERA, poses, 0, density) for density in (1, 4, 16)]
    assert found[1] == occlusion(bodies, CAMERA, poses, 0)
    assert len(set(found)) == 3
    np.testing.assert_allclose(found, found[-1], atol=0.1)
    assert 0.1 < found[-1] < 0.9


def test_a_process_may_see_more_objects_than_embree_has_scenes_for(make_box):
    """It ends a process that holds a thousand of them."""
    for number in range(1200):
        body_of(make_box(f"box {number}", (0.1, 0.05, 0.03)))
