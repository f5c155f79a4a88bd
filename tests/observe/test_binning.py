"""One pixel of several: what it keeps of depths, masks, colours and geometry."""

import numpy as np
import pytest

from mechsearch.camera import Camera, look_at, preset
from mechsearch.observe.binning import binned, bins_of
from mechsearch.observe.observation import without_holes
from mechsearch.observe.reprojection import reproject
from mechsearch.observe.sensor import SENSORS

VIEW, FINE = preset("overhead"), preset("overhead", 256)


def cells(*blocks):
    """Return an image of one row of square blocks, each given by its four pixels, row by row."""
    return np.concatenate([np.reshape(block, (2, 2)) for block in blocks], axis=1)


def test_a_depth_is_the_median_of_what_was_measured():
    depth = cells(
        [0.9, 0.902, 0.904, 0.99],  # two in the middle: their mean
        [0.9, 0.9, 1.0, 1.0],  # an edge between them: the nearer
        [0.0, 0.0, 0.8, 0.0],  # one alone
        [0.0, 0.0, 0.0, 0.0],
        [0.0, 0.95, 0.96, 0.5],  # three: what flies does not count
    )
    camera = Camera(10, 2, 50, 50, 4.5, 0.5, VIEW.world_from_camera)
    found, *_ = binned(depth, camera, 2, None)
    np.testing.assert_allclose(found, [[0.903, 0.9, 0.8, 0, 0.95]])


def test_a_mask_is_that_of_most_pixels_and_a_colour_the_mean():
    masks = cells([1, 1, 1, 0], [1, 0, 0, 0], [2, 2, 1, 1], [3, 1, 0, 0]).astype(np.uint8)
    colour = np.stack([masks * 10] * 3, axis=-1)
    camera = Camera(8, 2, 50, 50, 3.5, 0.5, VIEW.world_from_camera)
    _, _, mask, mean = binned(np.ones((2, 8)), camera, 2, masks, colour)
    assert mask.dtype == np.uint8
    assert mask.tolist() == [[1, 0, 2, 0]]
    assert mean[0, :, 1].tolist() == [8, 2, 15, 10]
    _, _, half, _ = binned(np.ones((2, 8)), camera, 2, masks > 0)
    assert half.tolist() == [[True, False, True, True]]


@pytest.mark.parametrize("bins", [1, 3, 4])
def test_a_plane_stays_where_it_is_and_what_is_left_over_is_left_out(bins):
    camera = Camera(82, 61, 90, 95, 40.2, 29.7, look_at((0.3, -0.5, 0.9), (0, 0, 0), (0, 0, 1)))
    rays = camera.directions() @ camera.pose[2, :3]
    depth, own, *_ = binned(-camera.pose[2, 3] / rays, camera, bins, None)
    assert depth.shape == (own.height, own.width) == (61 // bins, 82 // bins)
    np.testing.assert_allclose(own.back_project(depth)[..., 2], 0, atol=2e-4)


def test_the_views_own_finer_image_becomes_the_view():
    assert bins_of(FINE, VIEW) == 4
    assert bins_of(VIEW, VIEW) == bins_of(VIEW, FINE) == 1
    _, camera, *_ = binned(np.ones((256, 256)), FINE, 4, None)
    assert camera == VIEW


def test_a_camera_is_as_fine_as_its_pixels_on_the_table():
    for away, expected in [(0.5, 10), (1.0, 5), (1.3, 3), (3.0, 1)]:
        tilted = look_at((0.6 * away, 0, 0.8 * away), (0, 0, 0), (0, 0, 1))
        aside = Camera(640, 480, 460, 460, 319.5, 239.5, tilted)
        assert bins_of(aside, VIEW) == expected


def test_a_policy_sees_noise_edges_and_holes_of_a_finer_image_less(heap):
    """The same heap by the same sensor, at a policy's size and at four times it."""
    heap, renderer = heap
    sensor, true = SENSORS["stereo"], renderer.frame(VIEW, heap.poses).depth
    errors = {}
    for camera in (VIEW, FINE):
        frame = renderer.frame(camera, heap.poses, colour=True)
        rng = np.random.default_rng(0)
        seen = [sensor.measure(frame.depth, camera, rng, frame.rgb) for _ in range(10)]
        views = [binned(depth, camera, bins_of(camera, VIEW), None)[0] for depth in seen]
        error = np.abs(np.stack([without_holes(view, most=1.0) for view in views]) - true)
        errors[camera] = error.mean(), (error > 0.01).mean(), np.mean(np.stack(views) == 0)
    fine, coarse = errors[FINE], errors[VIEW]
    assert fine[0] < 0.9 * coarse[0]
    assert fine[1] < 0.7 * coarse[1]
    assert fine[2] < 0.2 * coarse[2]


def test_a_noisy_image_from_aside_is_binned_on_its_way_into_the_view(heap):
    heap, renderer = heap
    aside = Camera(
        640, 480, 417, 417, 319.5, 239.5, look_at((0, -0.52, 0.74), (0, 0, 0), (0, 0, 1))
    )
    frame = renderer.frame(aside, heap.poses)
    noisy = frame.depth + np.random.default_rng(0).normal(0, 0.004, frame.depth.shape)
    true = reproject(frame.depth, aside, VIEW, frame.modal(heap.target))
    plain, better = (
        reproject(noisy, aside, VIEW, frame.modal(heap.target), bins=bins) for bins in (False, True)
    )
    off = [np.median(np.abs(found.depth - true.depth)) for found in (plain, better)]
    assert off[1] < 0.6 * off[0]
    # Noise moves what is seen from aside to other pixels, too.
    assert (better.mask ^ true.mask).sum() < (plain.mask ^ true.mask).sum()
