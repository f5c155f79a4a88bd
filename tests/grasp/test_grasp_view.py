import numpy as np
import pytest

from mechsearch.grasp.depth_image import view_of_image
from mechsearch.grippers import check_opening, metric_camera
from mechsearch.observe.observation import without_holes
from mechsearch.types import MechSearchError


@pytest.fixture
def mask():
    inside = np.zeros((120, 160), np.uint8)
    inside[50:70, 60:90] = 255
    return inside


def test_a_good_image_is_kept_as_it_is(bumpy, mask, overhead):
    view = view_of_image(bumpy[..., None], mask, overhead)
    np.testing.assert_array_equal(view.depth, bumpy)
    assert view.mask.sum() == 600
    assert view.far == np.float32(0.8)


def test_holes_are_filled_and_are_no_part_of_the_target(bumpy, mask, overhead):
    bumpy[55, 60:70] = 0.0
    bumpy[10, 10] = np.nan
    view = view_of_image(bumpy, mask, overhead)
    np.testing.assert_array_equal(view.depth, without_holes(bumpy))
    assert view.mask.sum() == 590


def test_bad_images_are_refused_in_words(bumpy, mask, overhead):
    def refused(text, depth, inside=mask, camera=overhead):
        with pytest.raises(MechSearchError, match=text):
            view_of_image(depth, inside, camera)

    refused("is it in millimetres", bumpy * 1000)
    refused(r"the mask is \(100, 160\)", bumpy, mask[:100])
    refused("no target is visible", bumpy, mask * 0)
    refused("no target is visible", np.where(mask, 0, bumpy))
    refused("intrinsics are for", bumpy[:100], mask[:100])
    refused("has no depth", bumpy * 0)
    refused(r"expected \(H, W\)", np.stack([bumpy] * 3, -1))
    refused("at the target 5 cm are 8.* px; expected at least 11.5", bumpy * 4)
    refused("expected metres", bumpy / 1000)


def test_a_gripper_of_another_size_is_refused():
    check_opening(0.055)
    for opening in (0.03, 0.085):
        with pytest.raises(MechSearchError, match="50 to 60 mm"):
            check_opening(opening)


def test_the_metric_camera_looks_straight_down_on_its_point():
    camera = metric_camera([0.1, -0.2, 0.05], 0.1)
    centre = (camera.width - 1) / 2
    np.testing.assert_allclose(camera.project([0.1, -0.2, 0.0]), [centre, centre, 0.8], atol=1e-9)
    highest = camera.project([0.2, -0.2, 0.15])
    assert highest[0] + 48 < camera.width
    right = camera.project([0.11, -0.2, 0.0]) - camera.project([0.1, -0.2, 0.0])
    assert right[0] > 0
    assert right[1] == pytest.approx(0)
