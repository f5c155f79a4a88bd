import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mechsearch.camera import VIEWS, Camera, mounted, preset
from mechsearch.types import MechSearchError


@given(st.sampled_from(list(VIEWS)), st.integers(0, 2**32 - 1), st.sampled_from([64, 84, 128]))
def test_projecting_a_back_projected_pixel_returns_it(name, seed, size):
    camera = preset(name, size)
    depth = np.random.default_rng(seed).uniform(0.3, 2.0, (size, size))
    projected = camera.project(camera.back_project(depth))
    columns, rows = np.meshgrid(np.arange(size), np.arange(size))
    np.testing.assert_allclose(projected[..., 0], columns, atol=1e-8)
    np.testing.assert_allclose(projected[..., 1], rows, atol=1e-8)
    np.testing.assert_allclose(projected[..., 2], depth, atol=1e-9)


@given(st.sampled_from(list(VIEWS)), st.integers(0, 2**32 - 1), st.integers(8, 200))
def test_a_point_lies_on_the_ray_of_its_own_pixel_at_its_own_depth(name, seed, size):
    camera = preset(name, size)
    point = np.random.default_rng(seed).uniform([-0.3, -0.3, 0], [0.3, 0.3, 0.25])
    column, row, depth = camera.project(point)
    ray = [(column - camera.cx) / camera.fx, (row - camera.cy) / camera.fy, 1.0]
    eye = camera.pose[:3, 3]
    np.testing.assert_allclose(eye + depth * (camera.pose[:3, :3] @ ray), point, atol=1e-12)
    assert depth == pytest.approx((point - eye) @ camera.pose[:3, 2])


@given(st.sampled_from(list(VIEWS)), st.integers(0, 2**32 - 1))
def test_points_at_places_of_the_image_project_back_there(name, seed):
    camera, rng = preset(name), np.random.default_rng(seed)
    columns, rows, depths = rng.uniform(0, 63, (2, 3)), rng.uniform(0, 63, (2, 3)), rng.random() + 1
    projected = camera.project(camera.points_at(columns, rows, np.full((2, 3), depths)))
    np.testing.assert_allclose(projected[..., 0], columns, atol=1e-9)
    np.testing.assert_allclose(projected[..., 1], rows, atol=1e-9)
    np.testing.assert_allclose(projected[..., 2], depths)
    one = camera.points_at(columns[1, 2], rows[1, 2], depths)
    np.testing.assert_allclose(camera.project(one), projected[1, 2], atol=1e-9)


@given(st.sampled_from(list(VIEWS)), st.integers(8, 200), st.integers(8, 200))
def test_a_resized_view_maps_pixels_in_proportion_and_back(name, one, other):
    camera = preset(name, one)
    point = [0.1, -0.07, 0.05]
    before, after = camera.project(point)[:2], camera.resized(other).project(point)[:2]
    np.testing.assert_allclose((after + 0.5) / other, (before + 0.5) / one, atol=1e-12)


def test_overhead_columns_run_along_x_and_rows_against_y():
    column, row, depth = preset("overhead").project([0.1, 0.2, 0.0])
    assert depth == pytest.approx(1.0)
    assert column == pytest.approx(31.5 + 9.2)
    assert row == pytest.approx(31.5 - 18.4)


def test_a_resized_view_shows_the_same_corner():
    small, large = preset("tilted", 64), preset("tilted", 128)
    point = small.back_project(np.ones((64, 64)))[0, 0]
    assert large.project(point)[:2] == pytest.approx([0.5, 0.5])


def test_the_tilted_view_sees_the_workspace_and_keeps_up_upwards():
    camera = preset("tilted")
    corners = [[x, y, 0.0] for x in (-0.25, 0.25) for y in (-0.2, 0.3)]
    pixels = camera.project(corners)[:, :2]
    assert (pixels > 0).all()
    assert (pixels < 63).all()
    assert camera.project([0, 0, 0.2])[1] < camera.project([0, 0, 0])[1]


def test_unknown_views_and_wrong_depths_are_named():
    with pytest.raises(MechSearchError, match=r"'side'.*overhead, tilted"):
        preset("side")
    with pytest.raises(MechSearchError, match=r"\(3, 3\).*\(64, 64\)"):
        preset("overhead").back_project(np.ones((3, 3)))
    with pytest.raises(MechSearchError, match="focal length"):
        Camera(4, 4, 0.0, 1.0, 0, 0, tuple(np.eye(4).ravel()))
    with pytest.raises(MechSearchError, match="principal point is finite, not cx nan"):
        Camera(4, 4, 1.0, 1.0, np.nan, 0, tuple(np.eye(4).ravel()))
    for strange in (
        np.diag([1, 1, -1, 1]),
        2 * np.eye(4),
        np.full((4, 4), np.nan),
        np.ones((4, 4)),
    ):
        with pytest.raises(MechSearchError, match="expected a rigid transform"):
            Camera(4, 4, 1.0, 1.0, 0, 0, tuple(strange.ravel()))


def test_a_mounted_camera_is_where_its_text_says_and_75_degrees_across():
    camera = mounted(" 30 2  640 x 480 ", "overhead")
    assert (camera.width, camera.height) == (640, 480)
    np.testing.assert_allclose(camera.pose[:3, 3], [0, -1, np.sqrt(3)])
    np.testing.assert_allclose(camera.project([0, 0, 0]), [319.5, 239.5, 2])
    # +x is on the right, and what is further away higher up.
    across = camera.project([2 * np.tan(np.deg2rad(37.5)), 0, 0])
    np.testing.assert_allclose(across, [639.5, 239.5, 2])
    assert camera.project([0, 0.3, 0])[1] < 239.5
    assert (
        mounted("0 1 64x64", "overhead").pose[:3, :3].tolist()
        == VIEWS["overhead"].pose[:3, :3].tolist()
    )


@pytest.mark.parametrize(
    "text",
    [
        *(
            "x",
            "35 0.9",
            "35 0.9 640",
            "90 0.9 640x480",
            "-5 0.9 640x480",
            "35 0 640x480",
            "35 6 640x480",
        ),
        *("35 0.9 4x480", "35 0.9 640x48000", "35 0.9 640x480 7", "35 6 640x480"),
    ],
)
def test_what_says_no_mounted_camera_is_refused(text):
    with pytest.raises(
        MechSearchError, match=r"mounted is '.*'; expected degrees off the vertical"
    ):
        mounted(text, "overhead")


def test_a_mounted_camera_that_sees_too_little_of_the_view_is_refused():
    with pytest.raises(MechSearchError, match=r"where \d+% of the view 'overhead' is in the image"):
        mounted("35 0.3 640x480", "overhead")
