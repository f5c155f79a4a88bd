import numpy as np
import pytest

from mechsearch.camera import preset
from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig
from mechsearch.observe.observation import KEYS, position_image
from mechsearch.render.renderer import Renderer
from mechsearch.types import ACTOR_KEYS, PRIVILEGED_KEYS, RGB_ACTOR_KEYS, MechSearchError, select

FIXED = {"heap": 0, "fixed_start": True}


def test_the_actors_and_the_privileged_keys_are_disjoint():
    assert not {*ACTOR_KEYS, *RGB_ACTOR_KEYS} & set(PRIVILEGED_KEYS)
    assert {*ACTOR_KEYS, *RGB_ACTOR_KEYS, *PRIVILEGED_KEYS} == set(KEYS)


@pytest.mark.parametrize("view", ["overhead", "tilted"])
def test_a_position_image_added_to_the_effector_lies_on_the_object(boxes, view):
    camera, pose = preset(view, 128), [0.1, -0.05, 0.03, 1, 0, 0, 0]
    frame = Renderer([boxes.models["cube"]]).frame(camera, [pose])
    ee = np.array([-0.2, 0.1, 0.15])
    image = position_image(frame.modal(0), frame.depth, camera, ee).astype(float)
    assert (image[:, ~frame.modal(0)] == 0).all()
    points = image[:, frame.modal(0)].T + ee - pose[:3]
    on_surface = np.abs(points).max(axis=1)
    np.testing.assert_allclose(on_surface, 0.03, atol=1e-3)


def test_the_colour_ablation_shows_colour_and_a_label_instead_of_positions(covered, boxes):
    env = HeapEnv([covered], boxes, HeapEnvConfig(keys=RGB_ACTOR_KEYS))
    obs, _ = env.reset(options=FIXED)
    assert set(obs) == set(RGB_ACTOR_KEYS)
    assert obs["rgb"].shape == (3, 64, 64)
    assert obs["rgb"].dtype == np.uint8
    assert obs["target_label"].tolist() == [name == "cube" for name in boxes.models]
    assert env.observation_space.contains(obs)


def test_a_policy_is_handed_its_own_keys_alone(covered, boxes):
    obs, _ = HeapEnv([covered], boxes, HeapEnvConfig(privileged=True)).reset(options=FIXED)
    assert tuple(select(obs, ("depth",))) == ("depth",)
    bare, _ = HeapEnv([covered], boxes).reset(options=FIXED)
    with pytest.raises(MechSearchError, match=r"target_offset.*privileged=True"):
        select(bare, ("target_offset",))


def test_turning_the_world_turns_the_overhead_image(boxes):
    """A quarter turn of the scene about the vertical is a quarter turn of the picture."""
    models, camera = [boxes.models["cube"]], preset("overhead")
    before = Renderer(models).frame(camera, [[0.15, 0.05, 0.03, 1, 0, 0, 0]])
    after = Renderer(models).frame(camera, [[-0.05, 0.15, 0.03, 1, 0, 0, 0]])
    np.testing.assert_array_equal(np.rot90(before.modal(0)), after.modal(0))
