"""Observations from anywhere, such as from a robot: read as they are, or refused by name."""

import subprocess
import sys

import numpy as np
import pytest

from mechsearch.camera import preset
from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig
from mechsearch.env.retrieve_env import RetrieveEnv
from mechsearch.env.task import RetrieveConfig
from mechsearch.observe.observation import KEYS, KINDS, position_image, readable, without_holes
from mechsearch.sim.scene import Workspace
from mechsearch.types import ACTOR_KEYS, RETRIEVAL_KEYS, TEACHER_KEYS, MechSearchError

CLIP = Workspace().clip


@pytest.fixture(scope="module")
def pushing(covered, boxes):
    env = HeapEnv([covered], boxes, HeapEnvConfig(keys=KEYS))
    return env.reset(options={"heap": 0, "fixed_start": True})[0]


@pytest.fixture(scope="module")
def retrieving(covered, boxes):
    keys = tuple(KINDS)
    return RetrieveEnv([covered], boxes, RetrieveConfig(keys=keys)).reset(seed=0)[0]


def test_what_environments_show_is_handed_on_as_it_is(pushing, retrieving):
    for obs in (pushing, retrieving):
        read = readable(obs, tuple(obs), 64, CLIP)
        assert list(read) == list(obs)
        assert all(read[key] is obs[key] for key in obs)


def test_numbers_may_be_of_other_types_and_in_other_containers(pushing):
    given = {key: pushing[key].astype(np.float64) for key in ACTOR_KEYS} | {
        "ee_position": pushing["ee_position"].tolist()
    }
    read = readable(given, ACTOR_KEYS)
    for key in ACTOR_KEYS:
        np.testing.assert_array_equal(read[key], pushing[key])


def put(key, value, at=None):
    """Return what puts a value, at one place or as the whole, into a copy of an observation."""

    def change(obs):
        if at is None:
            return {**obs, key: value(obs[key]) if callable(value) else value}
        array = obs[key].copy()
        array[at] = value
        return {**obs, key: array}

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (put("depth", lambda d: d * 0), "depth has no depth, 0 or not finite, in 100% of its"),
        (put("depth", lambda d: d * np.nan), "depth has no depth.* in 100%"),
        (put("depth", lambda d: d.astype(float) * 800), "depth is 800 in the median: is it in mi"),
        (put("depth", lambda d: (d * 800).astype(np.uint16)), "depth is of uint16: is it in milli"),
        (put("depth", lambda d: d[0]), r"depth has shape \(64, 64\); expected \(1, 64, 64\): m a"),
        (put("depth", lambda d: d[:, ::2]), r"shape \(1, 32, 64\); expected \(1, 64, 64\)"),
        (put("depth", [[1.0], [1.0, 2.0]]), "depth is .*float16.*got .*inhomog"),
        (put("depth", "file.png"), "depth is .*got 'file.png'"),
        (put("position_image", np.nan, (0, 3, 4)), "position_image holds nan in 1 of 12288 places"),
        (put("position_image", lambda p: p * 0 + 80), "position_image holds 80.0 .*from -2 to 2"),
        (put("rgb", lambda c: c / 255), r"rgb is of float64; expected \(3, H, W\) uint8 from 0 to"),
        (put("ee_position", (0.2, np.nan, 0.1)), "ee_position holds nan in 1 of 3 places"),
        (
            put("ee_position", (0.2, -0.45, 0.1)),
            r"ee_position is \(0.200, -0.450, 0.100\) m, 0.150 m outside the workspace; the "
            r"nearest position in it is \(0.200, -0.300, 0.100\)",
        ),
        (put("ee_position", (0.2, 0.1, 0.1, 1.0)), r"ee_position has shape \(4,\); expected \(3"),
        (put("ee_position", None), "ee_position is .*; got None"),
        (put("target_offset", np.inf, 1), "target_offset holds inf in 1 of 3 places; expected"),
        (put("clutter_mask", lambda m: m[:1]), r"clutter_mask has shape \(1,\); expected \(2,\)"),
        (put("clutter_mask", 7, 0), r"clutter_mask holds 7 in 1 of 2 places; expected \(N,\) int8"),
        (lambda obs: {"depth": obs["depth"]}, "lacks position_image, .*expected depth, .*has"),
        (lambda obs: (obs, {}), "an observation is a tuple; expected arrays by key: depth, positi"),
        (lambda obs: None, "an observation is a NoneType"),
    ],
)  # fmt: skip
def test_what_no_policy_can_read_is_refused_by_name(pushing, change, message):
    with pytest.raises(MechSearchError, match=message) as found:
        readable(change(pushing), KEYS, 64, CLIP)
    assert "\n" not in str(found.value)


def test_an_end_effector_at_the_edge_may_be_measured_a_little_outside(pushing):
    readable(put("ee_position", (0.315, 0.0, 0.0))(pushing), TEACHER_KEYS, None, CLIP)


def test_images_for_grasping_are_read_alike(retrieving):
    for change, message in [
        (put("grasp_depth", 0.0, (slice(300), ...)), "grasp_depth has no depth.* in 59% of its"),
        (put("grasp_depth", lambda d: d * 1000), "grasp_depth is 800 in the median: is it in mil"),
        (put("segments", -1), r"segments has shape \(\)"),
        (put("segments", lambda s: s[1:]), r"segments has shape \(511, 512\); expected \(512, 512"),
        (put("grasps_left", [2.5]), "grasps_left is of float64"),
    ]:
        with pytest.raises(MechSearchError, match=message):
            readable(change(retrieving), RETRIEVAL_KEYS)
    holed = put("grasp_depth", np.nan, (slice(40, 60), slice(70, 90)))(retrieving)
    assert np.isfinite(readable(holed, RETRIEVAL_KEYS)["grasp_depth"]).all()


def test_a_hole_takes_the_depth_of_the_nearest_pixel_that_has_one():
    depth = np.array([[1.0, 2.0, 3.0, 4.0], [5.0, 0.0, np.nan, 8.0], [9.0, 1.5, 2.5, np.inf]])
    # All four neighbours are as near: one of them is taken.
    filled = without_holes(depth)
    assert filled[1, 1] in (2.0, 5.0, 1.5)
    assert filled[1, 2] in (3.0, 8.0, 2.5)
    assert filled[2, 3] in (8.0, 2.5)
    measured = (depth > 0) & (depth < np.inf)
    np.testing.assert_array_equal(filled[measured], depth[measured])


def test_holes_are_filled_as_a_search_through_all_pixels_fills_them():
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.5, 1.0, (1, 24, 31)).astype(np.float16)
    depth[rng.random(depth.shape) < 0.3] = 0
    filled = without_holes(depth)
    assert (filled.shape, filled.dtype) == (depth.shape, depth.dtype)
    there = np.argwhere(depth[0] > 0)
    for row, column in np.argwhere(depth[0] == 0):
        away = ((there - (row, column)) ** 2).sum(axis=1)
        nearest = depth[0][tuple(there[away == away.min()].T)]
        assert filled[0, row, column] in nearest


def test_half_an_image_of_holes_is_refused_and_less_is_not():
    depth = np.ones((10, 10))
    depth[:4] = 0
    assert (without_holes(depth) == 1).all()
    depth[4] = -1
    with pytest.raises(MechSearchError, match="in 50% of its pixels; expected less than 50%"):
        without_holes(depth)


def test_holes_are_no_part_of_a_position_image():
    camera, ee = preset("overhead", 8), np.array([0, 0, 0.5])
    depth = np.ones((8, 8))
    whole = position_image(np.ones((8, 8), bool), depth, camera, ee)
    depth[2, :3] = 0, np.nan, np.inf
    image = position_image(np.ones((8, 8), bool), depth, camera, ee)
    assert (image[:, 2, :3] == 0).all()
    measured = np.isfinite(depth) & (depth > 0)
    np.testing.assert_array_equal(image[:, measured], whole[:, measured])


def test_a_robots_code_needs_neither_simulator_nor_pytorch_to_read_its_camera():
    code = (
        "import sys; from mechsearch.observe.observation import position_image, readable, "
        "without_holes; from mechsearch.observe import reprojection, sensor; "
        "print([n for n in ('mujoco', 'torch', 'embreex') if n in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
