"""Images of any calibrated camera in the view that a policy knows."""

import numpy as np
import pytest

from mechsearch.camera import Camera, look_at, preset
from mechsearch.observe.observation import without_holes
from mechsearch.observe.reprojection import reproject
from mechsearch.render.renderer import Renderer
from mechsearch.types import MechSearchError

VIEW = preset("overhead")


def camera(width, height, tilt, distance, around=0.7):
    """Return a camera of 75 degrees across that looks at the table's middle."""
    focal = width / 2 / np.tan(np.deg2rad(37.5))
    angle = np.deg2rad(tilt)
    flat = np.array([np.sin(around), -np.cos(around)]) * np.sin(angle)
    pose = look_at(distance * np.array([*flat, np.cos(angle)]), (0, 0, 0), (0, 0, 1))
    return Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2, pose)


@pytest.mark.parametrize("size", [(640, 480), (1280, 720)])
@pytest.mark.parametrize(("tilt", "distance"), [(20, 0.6), (35, 0.9), (50, 1.3), (50, 0.6)])
def test_a_heap_seen_from_the_side_is_as_seen_from_above(heap, size, tilt, distance):
    heap, renderer = heap
    aside = camera(*size, tilt, distance)
    frame, above = renderer.frame(aside, heap.poses), renderer.frame(VIEW, heap.poses)
    found = reproject(frame.depth, aside, VIEW, frame.modal(heap.target))
    holes = found.depth == 0
    error = np.abs(found.depth - above.depth)[~holes]
    assert np.quantile(error, 0.95) < 1e-5
    assert error.mean() < 0.0005
    assert (error > 0.01).mean() < 0.01
    # At 0.6 m a camera does not see all of the table.
    assert holes.mean() < (0.27 if distance == 0.6 else 0.12)
    assert np.abs(without_holes(found.depth) - above.depth).mean() < 0.006
    # Borders stay where they are: near bodies are neither wider nor narrower.
    target = above.modal(heap.target)
    assert not (found.mask & holes).any()
    assert (found.mask != target)[~holes].sum() <= 0.06 * target.sum()


@pytest.mark.parametrize("view", [VIEW, camera(160, 120, 30, 0.8)])
def test_an_image_in_its_own_view_is_itself(heap, view):
    heap, renderer = heap
    frame = renderer.frame(view, heap.poses, colour=True)
    mask = frame.modal(heap.target)
    found = reproject(frame.depth, view, view, mask, frame.rgb)
    np.testing.assert_allclose(found.depth, frame.depth, atol=1e-6)
    np.testing.assert_array_equal(found.mask, mask)
    np.testing.assert_array_equal(found.colour, frame.rgb)


def test_a_denser_view_has_no_holes_between_the_pixels_of_a_surface():
    view = preset("overhead", 256)
    for tilt in (0.1, 45):
        aside = camera(320, 240, tilt, 1.2)
        depth = 1 / (aside.directions() @ aside.pose[2, :3] / -aside.pose[2, 3])
        found = reproject(depth, aside, view)
        np.testing.assert_allclose(found.depth, 1.0, atol=1e-5)


def test_surfaces_end_half_way_between_pixels_that_see_an_edge():
    aside = camera(32, 24, 0.1, 1.2)
    depth = np.random.default_rng(0).choice([0.0, 0.7, 0.8, 0.9], (24, 32))
    depth[depth == 0.9] = np.nan
    found = reproject(depth, aside, aside.resized(96))
    expected = np.kron(np.nan_to_num(depth), np.ones((4, 4)))
    np.testing.assert_allclose(found.depth, expected, atol=1e-6)


def test_the_nearest_surface_prevails_and_the_floor_is_not_seen_through_the_table(boxes):
    renderer = Renderer([boxes.models["cube"]])
    aside = camera(640, 480, 50, 1.3)
    frame = renderer.frame(aside, [[0, 0, 0.3, 1, 0, 0, 0]])
    above = renderer.frame(VIEW, [[0, 0, 0.3, 1, 0, 0, 0]])
    # It hovers, so that the table under it is seen from the side.
    found = reproject(frame.depth, aside, VIEW, frame.modal(0))
    assert (np.abs(found.depth - above.depth)[above.modal(0)] < 0.07).mean() > 0.95
    assert found.depth.max() < 1.01


GOOD = camera(64, 48, 30, 0.8)
FLAT = np.ones((48, 64), np.float32)


def moved(eye, target):
    pose = look_at(eye, target, (0, 1, 0))
    return Camera(64, 48, 50, 50, 31.5, 23.5, pose)


@pytest.mark.parametrize(
    ("depth", "camera", "more", "message"),
    [
        (FLAT, moved((0, 0, -0.5), (0, 0, 0)), {}, r"at \(0.000, 0.000, -0.500\) m, below the tab"),
        (FLAT, moved((0, 0, 0.5), (0, 0, 2)), {}, r"looks along \(.*1.000\), away from the table"),
        (FLAT * 0, GOOD, {}, "depth has no depth, 0 or not finite, in any of its pixels"),
        (FLAT * np.nan, GOOD, {}, "depth has no depth"),
        (FLAT * 800, GOOD, {}, "depth is 800 in the median: is it in millimetres"),
        (np.full((48, 64), 800), GOOD, {}, "is it in millimetres"),
        (FLAT[:, :50], GOOD, {}, r"depth has shape \(48, 50\); this camera's is \(48, 64\)"),
        (FLAT, GOOD, {"mask": FLAT[:5] > 0}, r"mask has shape \(5, 64\); expected \(48, 64\)"),
        (FLAT, GOOD, {"colour": FLAT}, r"colour has shape \(48, 64\); expected \(48, 64, 3\)"),
        (FLAT, moved((5, 0, 1), (5, 0, 0)), {}, "nothing that the camera at .* sees is in the vie"),
    ],
)
def test_what_cannot_be_is_refused(depth, camera, more, message):
    with pytest.raises(MechSearchError, match=message):
        reproject(depth, camera, VIEW, **more)
