import numpy as np
import pytest

from mechsearch.camera import preset
from mechsearch.pushes.push import look
from mechsearch.types import MechSearchError

FIXED = {"heap": 0, "fixed_start": True}


def test_the_target_is_seen_where_its_visible_part_is(env, camera, covered):
    obs, _ = env.reset(seed=0, options=FIXED)
    sight = look(obs, camera)
    # The lid leaves a strip of the cube's top free, at -3 to -1.5 cm.
    x, y, z = sight.centre - covered.poses[0, :3]
    assert -0.032 < x < -0.01
    assert abs(y) < 0.005
    assert z == pytest.approx(0.03, abs=3e-3)
    assert sight.target.sum() == np.any(obs["position_image"] != 0, axis=0).sum()


def test_heights_are_those_of_the_objects_and_the_end_effector_is_left_out(env, camera, covered):
    obs, _ = env.reset(seed=0, options=FIXED)
    env.world.place_pusher([0.025, 0.0, 0.1])
    over = look(env.restore(env.snapshot()), camera)
    column, row, _ = camera.project(covered.poses[1, :3])
    assert over.heights.max() == pytest.approx(0.08, abs=2e-3)
    assert over.heights[round(row), round(column)] == 0.0
    assert over.obstacles[:, 2].max() < 0.09
    del obs


def test_a_hidden_target_has_no_middle(env, camera):
    obs, _ = env.reset(seed=0, options=FIXED)
    hidden = {**obs, "position_image": np.zeros_like(obs["position_image"])}
    sight = look(hidden, camera)
    assert sight.centre is None
    assert not sight.target.any()


def test_images_of_another_size_are_refused(env):
    obs, _ = env.reset(seed=0, options=FIXED)
    with pytest.raises(MechSearchError, match=r"\(64, 64\)"):
        look(obs, preset("overhead", 32))
