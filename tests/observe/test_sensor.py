"""What a sensor gets wrong: how much, where alone, and the same again from the same seed."""

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.ndimage import binary_dilation, binary_erosion

from mechsearch.camera import Camera, preset
from mechsearch.observe.sensor import SENSORS, Sensor, cosines, sensor_named
from mechsearch.types import MechSearchError

SIDE = 200
VIEW = preset("overhead", SIDE)
OWN = VIEW.fx
"""Focal length of a sensor whose pixels are those of the image."""


def seen(sensor, depth, seed=0, camera=VIEW, **more):
    """Return what is measured, as double precision."""
    measured = sensor.measure(np.float32(depth), camera, np.random.default_rng(seed), **more)
    return measured.astype(np.float64)


def wall(depth):
    return np.full((SIDE, SIDE), depth, np.float32)


def plane(camera, normal, point):
    """Return the depth of a plane through a point, both in the camera's frame."""
    return np.dot(normal, point) / (camera.directions() @ normal)


@pytest.fixture(scope="module")
def step():
    """A table 1 m away and in its middle a block, 0.2 m high and 80 px wide."""
    depth = wall(1.0)
    depth[60:140, 60:140] = 0.8
    return depth


def test_a_perfect_sensor_hands_on_the_very_same_arrays():
    depth, mask, rng = wall(1.0), np.ones((SIDE, SIDE), np.bool_), np.random.default_rng(0)
    assert SENSORS["perfect"].measure(depth, VIEW, rng) is depth
    assert SENSORS["perfect"].segment(mask, VIEW, rng) is mask
    position = np.zeros(3)
    sensing = SENSORS["perfect"].episode((1, 2), 3)
    assert sensing.camera(VIEW) is VIEW
    assert sensing.effector(position) is position


@pytest.mark.parametrize("correlation", [0.0, 3.0])
def test_noise_grows_with_the_square_of_the_distance(correlation):
    sensor = Sensor(inverse_noise=0.004, correlation=correlation, focal=OWN)
    for distance in (0.5, 1.0, 2.0):
        # At the camera's foot the rays are within 20 degrees of the normal.
        error = seen(sensor, wall(distance)) - distance
        facing = cosines(wall(distance).astype(float), VIEW)
        spread = float((error * facing).std())
        assert spread == pytest.approx(0.004 * distance**2, rel=0.05 if not correlation else 0.1)
        assert abs(error.mean()) < 0.001


def test_a_stereo_camera_is_as_its_makers_say():
    """Distance^2 x subpixel / (focal length x baseline), 3.8 mm at 1 m of a D435, by hand."""
    assert SENSORS["stereo"].inverse_noise == pytest.approx(0.08 / (424 * 0.05))
    assert SENSORS["stereo"].inverse_noise == pytest.approx(0.00377, abs=1e-5)
    # Azure Kinect: 17 mm at 3.5 m.
    assert SENSORS["time-of-flight"].inverse_noise * 3.5**2 == pytest.approx(0.017)


def test_cosines_are_those_of_planes_and_noise_grows_with_one_over_them():
    for angle in (0.0, 30.0, 60.0, 75.0):
        normal = np.array([np.sin(np.deg2rad(angle)), 0, np.cos(np.deg2rad(angle))])
        # A long lens: all rays are nearly parallel.
        camera = Camera(SIDE, SIDE, 4000, 4000, 99.5, 99.5, VIEW.world_from_camera)
        depth = plane(camera, normal, [0, 0, 1.0])
        rays = camera.directions()
        expected = rays @ normal / np.linalg.norm(rays, axis=-1)
        np.testing.assert_allclose(cosines(depth, camera), expected, atol=1e-6)
        error = 1 / seen(Sensor(inverse_noise=0.002), depth, camera=camera) - 1 / depth
        assert error.std() == pytest.approx(0.002 / np.cos(np.deg2rad(angle)), rel=0.06)


def test_depth_comes_in_steps():
    slope = np.linspace(0.6, 1.2, SIDE * SIDE).reshape(SIDE, SIDE)
    millimetres = seen(Sensor(depth_step=0.001), slope) * 1000
    np.testing.assert_allclose(millimetres, np.round(millimetres), atol=1e-3)
    assert np.abs(millimetres / 1000 - slope).max() < 0.00051
    # 1/32 px of disparity, 424 px, 50 mm: 1.5 mm at 1 m.
    step = 1 / 32 / (424 * 0.05)
    levels = np.unique(seen(Sensor(inverse_step=step), slope))
    np.testing.assert_allclose(np.diff(1 / levels), -step, rtol=1e-3)
    at = np.searchsorted(levels, 1.0)
    assert levels[at] - levels[at - 1] == pytest.approx(0.00147, rel=0.01)


def beside_edges(width):
    """Return the pixels of the step within half a width of its edge."""
    block = np.zeros((SIDE, SIDE), np.bool_)
    block[60:140, 60:140] = True
    cross = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.bool_)
    return binary_dilation(block, cross, width // 2) & ~binary_erosion(block, cross, width // 2)


def test_holes_are_where_the_model_says_and_nowhere_else(step):
    assert (seen(Sensor(inverse_noise=1e-4), step) > 0).all()
    edge = beside_edges(2)
    np.testing.assert_array_equal(
        seen(Sensor(edge_width=2, edge_holes=1.0, focal=OWN), step) == 0, edge
    )
    half = seen(Sensor(edge_width=2, edge_holes=0.5, focal=OWN), step) == 0
    assert not half[~edge].any()
    assert half[edge].mean() == pytest.approx(0.5, abs=0.1)
    np.testing.assert_array_equal(seen(Sensor(farthest=0.9), step) == 0, step == 1.0)
    np.testing.assert_array_equal(seen(Sensor(nearest=0.9), step) == 0, step == np.float32(0.8))
    nothing = step.copy()
    nothing[:5] = 0
    np.testing.assert_array_equal(seen(Sensor(inverse_noise=1e-4), nothing) == 0, nothing == 0)
    colour = np.full((SIDE, SIDE, 3), 200, np.uint8)
    colour[:, :50] = 10
    dark = Sensor(dark=30, dark_holes=1.0)
    np.testing.assert_array_equal(seen(dark, step, colour=colour) == 0, colour[..., 0] == 10)
    share = (seen(replace(dark, dark_holes=0.3), step, colour=colour) == 0)[:, :50].mean()
    assert share == pytest.approx(0.3, abs=0.03)


def test_a_mirroring_surface_dazzles_where_it_faces_the_sensor():
    depth, glossy = wall(1.0), np.zeros((SIDE, SIDE), np.bool_)
    glossy[:, :120] = True
    rays = VIEW.directions()
    angle = np.rad2deg(np.arccos(1 / np.linalg.norm(rays, axis=-1)))
    holes = seen(Sensor(mirroring=5.0), depth, glossy=glossy) == 0
    np.testing.assert_array_equal(holes, glossy & (angle < 5))


def test_a_steep_surface_is_lost():
    for angle, lost in ((60.0, False), (80.0, True)):
        normal = np.array([np.sin(np.deg2rad(angle)), 0, np.cos(np.deg2rad(angle))])
        camera = Camera(SIDE, SIDE, 4000, 4000, 99.5, 99.5, VIEW.world_from_camera)
        holes = seen(Sensor(grazing=70.0), plane(camera, normal, [0, 0, 1.0]), camera=camera) == 0
        assert holes.all() == holes.any() == lost


def test_what_the_second_imager_does_not_see_is_lost(step):
    """The shadow is left of what is near, and as wide as the disparities differ."""
    # 0.1 m x 287.5 px (1 / 0.8 - 1 / 1) = 7.19 px.
    holes = seen(Sensor(baseline=0.1), step) == 0
    row = holes[100].nonzero()[0]
    assert set(range(53, 60)) <= set(row.tolist()) <= set(range(52, 60))
    assert not holes[:60].any()
    assert not holes[140:].any()


def test_flying_pixels_are_between_two_surfaces_at_their_edge(step):
    found = seen(Sensor(edge_width=2, flying=1.0, focal=OWN), step)
    flies = (np.abs(found - step) > 1e-6) & (np.abs(found - 1.8 + step) > 1e-6)
    assert not flies[~beside_edges(2)].any()
    assert flies[beside_edges(2)].mean() > 0.95
    assert found[flies].min() > 0.8
    assert found[flies].max() < 1.0


def test_lost_patches_are_as_many_and_as_large_as_said():
    sensor = Sensor(patches=2.0, patch_radius=10.0, focal=OWN)
    share = np.mean([(seen(sensor, wall(1.0), seed) == 0).mean() for seed in range(80)])
    # 2 pi r^2 (1 + 1 / 12), less what lies beyond the image or on each other.
    assert share == pytest.approx(2 * np.pi * 100 * 13 / 12 / SIDE**2, rel=0.25)


def test_an_error_means_as_much_of_the_scene_in_an_image_of_another_size():
    widths = []
    for size in (100, 400):
        view = preset("overhead", size)
        depth = np.ones((size, size), np.float32)
        depth[:, size // 2 :] = 0.8
        holes = seen(Sensor(edge_width=40, edge_holes=1.0), depth, camera=view) == 0
        widths.append(holes[0].sum() / size)
    assert widths[0] == pytest.approx(widths[1], rel=0.1)


@pytest.fixture(scope="module")
def disc():
    rows, columns = np.mgrid[:SIDE, :SIDE]
    return np.hypot(rows - 100, columns - 90) <= 30


def test_a_masks_border_moves_as_far_as_said(disc):
    sensor = Sensor(mask_shift=3.0, focal=OWN)
    rng = np.random.default_rng(4)
    areas = [sensor.segment(disc, VIEW, rng).sum() for _ in range(300)]
    moved = np.sqrt(np.array(areas) / np.pi) - 30
    assert moved.std() == pytest.approx(3.0, rel=0.15)
    assert abs(moved.mean()) < 0.6
    inwards = Sensor(mask_inset=3.0, focal=OWN).segment(disc, VIEW, rng)
    assert np.sqrt(inwards.sum() / np.pi) - 30 == pytest.approx(-3, abs=0.4)
    waves = Sensor(mask_waves=2.0, mask_part=8.0, focal=OWN).segment(disc, VIEW, rng)
    assert (waves & ~disc).any()
    assert (disc & ~waves).any()


def test_parts_of_a_mask_are_missing_or_false(disc):
    rng = np.random.default_rng(0)
    missing = Sensor(mask_missing=1.0, mask_part=8.0, focal=OWN).segment(disc, VIEW, rng)
    assert not (missing & ~disc).any()
    assert 50 < (disc & ~missing).sum() < 460
    wrong = Sensor(mask_false=1.0, mask_part=8.0, focal=OWN).segment(disc, VIEW, rng)
    assert not (disc & ~wrong).any()
    assert 0 < (wrong & ~disc).sum() < 460


def test_of_masks_that_grow_into_each_other_the_first_prevails(disc):
    numbers = np.zeros((SIDE, SIDE), np.uint8)
    numbers[:, 90:] = 2
    numbers[disc] = 1
    for seed in range(8):
        rng = np.random.default_rng(seed)
        found = Sensor(mask_shift=3.0, focal=OWN).segment(numbers, VIEW, rng)
        rng = np.random.default_rng(seed)
        alone = Sensor(mask_shift=3.0, focal=OWN).segment(disc, VIEW, rng)
        np.testing.assert_array_equal(found == 1, alone)
        assert set(np.unique(found)) == {0, 1, 2}


def test_a_camera_is_where_and_turned_as_said():
    sensor = Sensor(camera_shift=0.005, camera_turn=1.0)
    shifts, turns = [], []
    for seed in range(400):
        pose = sensor.episode((seed,), 0).camera(VIEW).pose
        shifts.append(pose[:3, 3] - VIEW.pose[:3, 3])
        turn = VIEW.pose[:3, :3].T @ pose[:3, :3]
        turns.append(np.rad2deg([turn[2, 1], turn[0, 2], turn[1, 0]]))
    np.testing.assert_allclose(np.std(shifts, axis=0), 0.005, rtol=0.15)
    np.testing.assert_allclose(np.std(turns, axis=0), 1.0, rtol=0.15)


ONE_BY_ONE = {name: sensor for name, sensor in SENSORS.items() if isinstance(sensor, Sensor)}


def test_a_mixture_is_each_of_its_sensors_equally_often_and_adds_nothing(step):
    ids, colour = np.where(step < 1, 0, -1).astype(np.int16), np.zeros((SIDE, SIDE, 3), np.uint8)

    def taken(sensor, episode):
        sensing = sensor.episode((4, 3, episode), 1)
        depth, mask = sensing.take(1, VIEW, step, step < 1, ids, colour) if (
            not sensing.is_perfect
        ) else (step, step < 1)  # fmt: skip
        return depth.tobytes() + mask.tobytes()

    each = {name: [taken(sensor, n) for n in range(100)] for name, sensor in ONE_BY_ONE.items()}
    mixed = [taken(SENSORS["mixed"], n) for n in range(100)]
    share = {
        name: np.mean([a == b for a, b in zip(mixed, own, strict=True)])
        for name, own in each.items()
    }
    assert sum(share.values()) == pytest.approx(1)
    assert min(share.values()) > 0.15


@pytest.mark.parametrize("name", [name for name in ONE_BY_ONE if name != "perfect"])
def test_the_same_seed_gives_the_same_bytes_and_another_step_others(name, step):
    colour = np.full((SIDE, SIDE, 3), 20, np.uint8)
    ids = np.where(step < 1, 0, -1).astype(np.int16)

    def taken(seed, number):
        sensing = SENSORS[name].episode(seed, 1)
        depth, mask = sensing.take(number, sensing.camera(VIEW), step, step < 1, ids, colour)
        return depth.tobytes() + mask.tobytes()

    assert taken((5, 3, 0), 1) == taken((5, 3, 0), 1)
    assert len({taken((5, 3, 0), 1), taken((5, 3, 0), 2), taken((5, 3, 1), 1)}) == 3


def test_all_is_switched_off_by_default_and_used_by_a_preset():
    unused = [f.name for f in fields(Sensor) if all(
        getattr(sensor, f.name) == f.default for sensor in ONE_BY_ONE.values()
    )]  # fmt: skip
    assert unused == ["mask_inset"]


def test_a_sensor_is_otherwise_where_its_text_says_so():
    changed = sensor_named("stereo camera_turn=1 mask_shift=0")
    assert changed == replace(SENSORS["stereo"], camera_turn=1.0, mask_shift=0.0)
    assert sensor_named("stereo") is SENSORS["stereo"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("lidar", "unknown sensor 'lidar'; choose one of perfect, ster"),
        ("", "unknown sensor ''; choose one of perfect, ster"),
        ("stereo turn=1", "otherwise in 'turn'; choose one of focal, baseline"),
        ("stereo camera_turn=x", "camera_turn is 'x'; expected a number from 0$"),
        ("stereo camera_turn=-1", "camera_turn is '-1'; expected a number from 0$"),
        ("stereo camera_turn=nan", "camera_turn is 'nan'; expected a number from 0$"),
        ("stereo camera_turn", "camera_turn is ''; expected a number from 0$"),
        ("perfect edge_holes=2", "edge_holes is '2'; expected a number from 0 to 1"),
        ("mixed camera_turn=1", "nothing of a mixture is otherwise"),
    ],
)
def test_a_sensor_that_is_none_is_refused(text, said):
    with pytest.raises(MechSearchError, match=said):
        sensor_named(text)
