import numpy as np
import pytest

from mechsearch.geometry import rotation_from_quaternion
from mechsearch.grippers import ImageGrasp, alike, angle_bin, bin_angle


def test_bins_and_angles_invert_each_other_modulo_half_a_turn():
    bins = np.arange(16)
    np.testing.assert_array_equal(angle_bin(bin_angle(bins)), bins)
    np.testing.assert_array_equal(angle_bin(bin_angle(bins) + np.pi), bins)
    np.testing.assert_array_equal(angle_bin(bin_angle(bins) - 3 * np.pi), bins)
    assert bin_angle(0) == pytest.approx(np.pi / 2 - np.pi / 32)


def test_an_overhead_grasp_points_down_and_closes_where_the_image_says(overhead):
    # 55.25 px right of the centre at 0.6 m is 6 cm along x; rows run along -y.
    grasp = ImageGrasp(59.5, 79.5 + 55.25, 0.6, 0.0)
    pose = grasp.pose(overhead)
    np.testing.assert_allclose(pose[:3], [0.06, 0.0, 0.2], atol=1e-12)
    np.testing.assert_allclose(rotation_from_quaternion(pose[3:]), np.eye(3), atol=1e-9)
    down = ImageGrasp(59.5, 79.5, 0.6, np.pi / 2).pose(overhead)
    rotation = rotation_from_quaternion(down[3:])
    np.testing.assert_allclose(rotation[:, 0], [0, -1, 0], atol=1e-9)
    np.testing.assert_allclose(rotation[:, 2], [0, 0, 1], atol=1e-9)


@pytest.mark.parametrize("angle", np.linspace(-3, 3, 13))
def test_every_grasp_is_a_rotation_whose_axis_projects_onto_the_image(overhead, angle):
    grasp = ImageGrasp(30.0, 100.0, 0.7, float(angle))
    pose = grasp.pose(overhead)
    rotation = rotation_from_quaternion(pose[3:])
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    ends = overhead.project([pose[:3], pose[:3] + 0.01 * rotation[:, 0]])
    np.testing.assert_allclose(ends[0], [100, 30, 0.7], atol=1e-9)
    step = (ends[1] - ends[0])[:2]
    np.testing.assert_allclose(step / np.linalg.norm(step), grasp.axis, atol=1e-9)


def test_grasps_are_alike_within_a_centimetre_and_two_bins():
    centres = np.array([[0, 0, 0.7], [0, 0, 0.7], [0, 0, 0.7], [0.009, 0, 0.7], [0, 0, 0.711]])
    angles = bin_angle(np.array([1, 15, 2, 0, 0]))
    found = alike(np.array([0, 0, 0.7]), float(bin_angle(0)), centres, angles)
    assert found.tolist() == [True, True, False, True, False]
