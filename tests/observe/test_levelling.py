"""An image is held against the table that it shows."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mechsearch.camera import mounted, preset
from mechsearch.observe.levelling import levelled

ABOVE, ASIDE = preset("overhead"), mounted("35 0.9 320x240", "overhead")


def off(camera, rng, turn=0.3, shift=0.002):
    """Return a camera that is not where it is believed to be, with errors of these std."""
    pose = camera.pose
    pose[:3, 3] += shift * rng.standard_normal(3)
    turned = Rotation.from_rotvec(np.deg2rad(turn) * rng.standard_normal(3)).as_matrix()
    pose[:3, :3] = pose[:3, :3] @ turned
    return replace(camera, world_from_camera=tuple(pose.ravel().tolist()))


@pytest.mark.parametrize("camera", [ABOVE, ASIDE])
def test_a_right_image_is_returned_as_it_is(heap, camera):
    heap, renderer = heap
    depth = renderer.frame(camera, heap.poses).depth
    again, same = levelled(depth, camera)
    assert again is depth
    assert same is camera


@pytest.mark.parametrize("camera", [ABOVE, ASIDE])
def test_a_wrong_scale_is_found(heap, camera):
    heap, renderer = heap
    true = renderer.frame(camera, heap.poses).depth
    depth, _ = levelled(true * np.float32(1.01), camera)
    assert depth.dtype == true.dtype
    assert np.abs(depth / true - 1).max() < 5e-4


@pytest.mark.parametrize(("camera", "less"), [(ABOVE, 0.5), (ASIDE, 0.75)])
def test_places_are_nearer_to_the_truth(heap, camera, less):
    """The errors of a stereo camera: height is known to half a millimetre, the rest better."""
    heap, renderer = heap
    rng, before, after = np.random.default_rng(0), [], []
    for _ in range(20):
        real, scale = off(camera, rng), 1 + 0.0067 * rng.standard_normal()
        frame = renderer.frame(real, heap.poses)
        target, depth = frame.modal(heap.target), frame.depth * np.float32(scale)
        corrected, own = levelled(depth, camera)
        true = real.back_project(frame.depth)[target].mean(axis=0)
        before.append(camera.back_project(depth)[target].mean(axis=0) - true)
        after.append(own.back_project(corrected)[target].mean(axis=0) - true)
    first, then = (np.sqrt(np.mean(np.square(errors), axis=0)) for errors in (before, after))
    assert then[2] < 0.0005 < 0.004 < first[2]
    assert np.linalg.norm(then[:2]) < less * np.linalg.norm(first[:2])


def test_holes_stay_and_noise_averages_out(heap):
    heap, renderer = heap
    rng = np.random.default_rng(1)
    true = renderer.frame(ABOVE, heap.poses).depth
    depth = (1.005 * true + 0.004 * rng.standard_normal(true.shape)).astype(np.float32)
    holes = rng.random(true.shape) < 0.3
    depth[holes] = 0
    found, own = levelled(depth, ABOVE)
    np.testing.assert_array_equal(found == 0, holes)
    error = own.back_project(found)[..., 2] - ABOVE.back_project(true)[..., 2]
    assert abs(error[~holes].mean()) < 0.0005


@pytest.mark.parametrize("wrong", ["no table", "far off", "holes"])
def test_what_shows_no_table_is_left_alone(heap, wrong):
    heap, renderer = heap
    depth = renderer.frame(ABOVE, heap.poses).depth
    given = {"no table": depth - 0.2, "far off": 1.08 * depth, "holes": 0 * depth}[wrong]
    depth, camera = levelled(given, ABOVE)
    assert depth is given
    assert camera is ABOVE
