import mujoco
import numpy as np
import pytest

from mechsearch.camera import preset
from mechsearch.geometry import random_quaternion
from mechsearch.objects.model import ObjectSet
from mechsearch.render.renderer import BACKGROUND, PUSHER, Renderer
from mechsearch.sim.scene import Pusher, pusher_model
from mechsearch.sim.world import World
from mechsearch.types import MechSearchError


def scattered(objects: ObjectSet, seed: int):
    rng = np.random.default_rng(seed)
    models = list(objects.models.values())
    poses = [
        [*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.05, 0.2), *random_quaternion(rng)]
        for _ in models
    ]
    return models, np.array(poses)


def cast(world: World, origin, directions):
    """Cast rays (K, 3) from one origin with the engine: distances, and object indices (-1)."""
    model, data = world._model, world._data
    mujoco.mj_forward(model, data)
    lengths = np.linalg.norm(directions, axis=1)
    unit = np.ascontiguousarray(directions / lengths[:, None]).ravel()
    geoms, distances = np.full(len(lengths), -1, np.int32), np.full(len(lengths), -1.0)
    mujoco.mj_multiRay(
        *(model, data, origin, unit, None, True, -1, geoms, distances, None, len(lengths), 100.0)
    )
    bodies = np.where(geoms >= 0, model.geom_bodyid[geoms], 0)
    objects = np.where((bodies >= 1) & (bodies <= world.count), bodies - 1, -1)
    return distances / lengths, objects


@pytest.mark.parametrize("view", ["overhead", "tilted"])
def test_rays_agree_with_the_engines_own(boxes, view):
    """The same convex meshes, cast ray by ray by an independent implementation."""
    models, poses = scattered(boxes, 3)
    camera = preset(view, 96)
    world = World(models)
    world.reset(poses)
    directions = (camera.directions() @ camera.pose[:3, :3].T).reshape(-1, 3)
    distance, objects = cast(world, camera.pose[:3, 3], directions)
    frame = Renderer(models).frame(camera, poses)
    ids = frame.ids.ravel()
    same = ids == objects
    # Rays that graze an edge may fall on either side of it.
    assert same.mean() > 0.999
    assert (ids >= 0).sum() > 300
    # The engine's table has no edge and no floor below.
    on_table = camera.back_project(frame.depth)[..., 2].ravel() > -0.01
    compared = same & on_table
    assert compared.mean() > 0.75
    np.testing.assert_allclose(frame.depth.ravel()[compared], distance[compared], atol=2e-5)


def test_depth_is_along_the_optical_axis(boxes):
    plate = [boxes.models["plate"]]
    frame = Renderer(plate).frame(preset("overhead"), [[0.2, 0.2, 0.01, 1, 0, 0, 0]])
    np.testing.assert_allclose(frame.depth[frame.ids == 0].max(), 0.98, atol=0.021)
    top = frame.depth[frame.modal(0)]
    assert np.isclose(top, 0.98, atol=1e-5).mean() > 0.7
    np.testing.assert_allclose(frame.depth[0, 0], 1.0, atol=1e-6)


def test_an_object_at_positive_x_and_y_appears_right_and_up(boxes):
    frame = Renderer([boxes.models["cube"]]).frame(
        preset("overhead"), [[0.1, 0.2, 0.03, 1, 0, 0, 0]]
    )
    rows, columns = np.nonzero(frame.modal(0))
    assert rows.max() < 32
    assert columns.min() > 32


def test_amodal_masks_contain_modal_masks_and_do_not_change_with_the_others(boxes):
    models, poses = scattered(boxes, 5)
    frame = Renderer(models).frame(preset("overhead", 128), poses)
    for i, model in enumerate(models):
        assert not (frame.modal(i) & ~frame.amodal[i]).any()
        alone = Renderer([model]).frame(preset("overhead", 128), poses[i : i + 1])
        np.testing.assert_array_equal(alone.ids == 0, frame.amodal[i])


def test_the_pusher_hides_pixels_but_has_no_amodal_mask(boxes):
    models, poses = [boxes.models["cube"]], np.array([[0, 0, 0.03, 1, 0, 0, 0]])
    renderer = Renderer(models, pusher_model(Pusher()))
    over = Pusher().pose(np.array([0.0, 0.0, 0.1]))
    frame = renderer.frame(preset("overhead", 128), poses, over)
    assert (frame.ids == PUSHER).sum() > 20
    assert frame.amodal.shape[0] == 1
    assert frame.modal(0).sum() < frame.amodal[0].sum()


@pytest.mark.parametrize("view", ["overhead", "tilted"])
def test_what_fills_the_view_fills_its_first_and_last_pixels(make_box, view):
    camera = preset(view)
    wall = make_box("wall", (2.0, 2.0, 0.01))
    ahead = camera.pose[:3, 3] + 0.3 * camera.pose[:3, 2]
    frame = Renderer([wall]).frame(camera, [[*ahead, 1, 0, 0, 0]])
    assert frame.modal(0).all()
    assert frame.amodal[0].all()


def test_a_splinter_before_the_lens_fills_the_whole_view(make_box):
    """Its end of 2 mm is 1.5 mm from the camera, whose plane it nearly reaches."""
    splinter = make_box("splinter", (0.002, 0.002, 0.03))
    frame = Renderer([splinter]).frame(preset("overhead"), [[0, 0, 0.9835, 1, 0, 0, 0]])
    assert frame.modal(0).all()


def test_colours_are_looked_up_where_the_object_is(boxes):
    renderer = Renderer([boxes.models["cube"]])
    frame = renderer.frame(preset("overhead"), [[0, 0, 0.03, 1, 0, 0, 0]], colour=True)
    inside = frame.rgb[frame.ids == 0]
    assert (inside[:, 0] == inside[:, 1]).all()
    assert len(np.unique(frame.rgb[frame.ids == BACKGROUND], axis=0)) == 1


def test_poses_of_another_heap_are_refused(boxes):
    with pytest.raises(MechSearchError, match=r"\(2, 7\)"):
        Renderer([boxes.models["cube"]]).frame(preset("overhead"), np.zeros((2, 7)))
