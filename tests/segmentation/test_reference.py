"""Reference views: what they show is the object alone, at a known size."""

import numpy as np
import pytest

from mechsearch.segmentation.reference import SIDE, cut_out, directions, render_references
from mechsearch.types import MechSearchError


def photograph(top, left, height, width, shape=(90, 120)):
    """Return a grey picture of a red rectangle, and its mask."""
    rgb, mask = np.full((*shape, 3), 90, np.uint8), np.zeros(shape, np.bool_)
    mask[top : top + height, left : left + width] = True
    rgb[mask] = (200, 40, 10)
    return rgb, mask


def test_a_photograph_is_cut_out_about_its_mask_and_nothing_else_is_left():
    views = cut_out(*zip(photograph(10, 20, 40, 20), photograph(0, 60, 30, 60), strict=True))
    assert views.rgb.shape == (2, SIDE, SIDE, 3)
    # The longer side fills the view but for 5 %; the other one is half as long.
    for mask, (rows, columns) in zip(views.mask, [(38, 19), (19, 38)], strict=True):
        assert abs(mask.any(axis=1).sum() - rows) <= 1
        assert abs(mask.any(axis=0).sum() - columns) <= 1
    assert (views.rgb[~views.mask] == 0).all()
    inside = views.rgb[views.mask].astype(int)
    assert np.abs(inside - (200, 40, 10)).max() <= 2
    assert (views.width == 0).all()


def test_the_width_of_a_view_is_its_side_at_the_object():
    rgb, mask = photograph(10, 20, 40, 20)
    assert cut_out([rgb], [mask], [0.002]).width == pytest.approx([40 * 1.05 * 0.002])


def test_a_view_does_not_depend_on_the_photographs_size():
    rgb, mask = photograph(10, 20, 40, 20)
    large = cut_out([rgb.repeat(4, 0).repeat(4, 1)], [mask.repeat(4, 0).repeat(4, 1)])
    small = cut_out([rgb], [mask])
    assert (large.mask == small.mask).mean() > 0.97


def test_views_of_a_mesh_have_its_silhouette(make_box):
    box = make_box("box", (0.12, 0.06, 0.03))
    views = render_references(box, np.eye(3))
    # Along x, y and z a box shows its sides' rectangles, larger as they are nearer than its middle.
    away = 8 * box.radius
    for mask, width, half, area in zip(
        views.mask, views.width, (0.06, 0.03, 0.015), (0.0018, 0.0036, 0.0072), strict=True
    ):
        expected = area * (away / (away - half)) ** 2
        assert mask.sum() * (width / SIDE) ** 2 == pytest.approx(expected, rel=0.06)


def test_directions_are_unit_vectors_in_all_octants():
    found = directions()
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0)
    assert len({tuple(row) for row in (found > 0).tolist()}) == 8


@pytest.mark.parametrize(
    ("images", "masks", "words"),
    [
        ([], [], "0 reference views and 0 masks"),
        ([photograph(1, 1, 9, 9)[0]], [], "1 reference views and 0 masks"),
        ([photograph(1, 1, 9, 9)[0]], [np.zeros((90, 120))], "has 0 pixels; expected at least 16"),
        ([photograph(1, 1, 9, 9)[0]], [photograph(1, 1, 3, 5)[1]], "view 0 has 15 pixels"),
        ([photograph(1, 1, 9, 9)[0]], [np.ones((9, 9))], r"\(90, 120, 3\) of uint8 with a mask"),
        ([photograph(1, 1, 9, 9)[1]], [photograph(1, 1, 9, 9)[1]], "view 0 is .* of bool"),
    ],
)
def test_what_is_no_view_is_refused(images, masks, words):
    with pytest.raises(MechSearchError, match=words):
        cut_out(images, masks)
