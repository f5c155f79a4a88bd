import numpy as np
import pytest
import torch

from mechsearch.grasp.graspability import rate
from mechsearch.grippers import GraspView, alike, cells, depth_bins


def view(depth, camera, rows, columns):
    mask = np.zeros(depth.shape, np.bool_)
    mask[rows, columns] = True
    return GraspView(depth, mask, camera, 0.8)


def test_depth_bins_are_the_middles_of_equal_parts():
    np.testing.assert_allclose(depth_bins(0.6, 0.8, 4), [0.625, 0.675, 0.725, 0.775])


def test_cells_are_every_fourth_pixel_of_the_mask():
    mask = np.zeros((20, 20), np.bool_)
    mask[3:9, 7:13] = True
    rows, columns = cells(mask)
    assert list(zip(rows, columns, strict=True)) == [(4, 8), (4, 12), (8, 8), (8, 12)]


def test_a_region_that_the_grid_misses_gets_one_cell_of_its_own():
    mask = np.zeros((20, 20), np.bool_)
    mask[5:8, 9:12] = True
    rows, columns = cells(mask)
    assert (rows.tolist(), columns.tolist()) == ([6], [10])


def test_rating_around_the_target_equals_rating_the_whole_image(untrained, bumpy, overhead):
    part = view(bumpy, overhead, slice(50, 66), slice(60, 90))
    ratings = rate(untrained, part)
    depths = torch.tensor(ratings.depths, dtype=torch.float32)
    whole = untrained.quality(torch.from_numpy(bumpy), depths).numpy()
    expected = whole[:, :, (ratings.rows - 48) // 4, (ratings.columns - 48) // 4]
    np.testing.assert_allclose(ratings.quality, expected, atol=1e-5)
    assert part.mask[ratings.rows, ratings.columns].all()


def test_the_image_goes_on_as_the_table_beyond_its_border(bumpy, overhead):
    corner = view(bumpy, overhead, slice(0, 5), slice(0, 5))
    crop = corner.around(0, 4, 0, 4)
    assert crop.shape == (100, 100)
    assert (crop[:48] == np.float32(0.8)).all()
    assert (crop[:, :48] == np.float32(0.8)).all()
    np.testing.assert_array_equal(crop[48:, 48:], bumpy[:52, :52])


def test_the_best_grasps_are_the_best(untrained, bumpy, overhead):
    ratings = rate(untrained, view(bumpy, overhead, slice(40, 80), slice(60, 100)))
    found = [grasp.quality for grasp in ratings.best(10)]
    np.testing.assert_array_equal(found, np.sort(ratings.quality.ravel())[:-11:-1])
    apart_ones = ratings.best_apart(10)
    assert apart_ones[0] == ratings.best(1)[0]
    centres = np.array([grasp.pose(overhead)[:3] for grasp in apart_ones])
    angles = np.array([grasp.angle for grasp in apart_ones])
    for i in range(1, len(apart_ones)):
        assert not alike(centres[i], angles[i], centres[:i], angles[:i]).any()
    assert len(apart_ones) == 10


def test_the_nearest_point_of_the_target_and_the_table_bound_the_depths(untrained, bumpy, overhead):
    bumpy[60:70, 80:90] = 0.7
    ratings = rate(untrained, view(bumpy, overhead, slice(60, 70), slice(80, 90)))
    assert ratings.depths[0] == pytest.approx(0.7 + 0.05 / 16, abs=2e-3)
    assert ratings.depths.max() < 0.8
