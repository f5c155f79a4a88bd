import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mechsearch.pushes.push import KINDS, Push, draw_pushes
from mechsearch.types import MechSearchError

CENTRE = np.array([0.1, -0.05, 0.04])


def test_a_straight_push_passes_the_target_at_its_side_from_before_to_after():
    push = Push("straight", np.pi / 2, lateral=0.03, before=0.08, after=0.12)
    first, last = push.path(CENTRE)
    # Ahead is +y, to the left of it is -x.
    np.testing.assert_allclose(first, [0.07, -0.13], atol=1e-12)
    np.testing.assert_allclose(last, [0.07, 0.07], atol=1e-12)


def test_a_spiral_winds_out_from_the_target_by_5_5_cm_a_turn():
    way = Push("spiral", 0.4, turns=1.5).path(CENTRE)
    offsets = way - CENTRE[:2]
    radii = np.linalg.norm(offsets, axis=1)
    angles = np.unwrap(np.arctan2(offsets[:, 1], offsets[:, 0]))
    assert radii[0] == pytest.approx(0.02)
    assert radii[-1] == pytest.approx(0.02 + 1.5 * 0.055)
    assert angles[0] == pytest.approx(0.4)
    assert angles[-1] - angles[0] == pytest.approx(3 * np.pi)
    assert (np.diff(radii) > 0).all()


def test_a_mirrored_spiral_is_the_mirror_image_at_its_direction():
    angle = 0.7
    left = Push("spiral", angle, turns=1.0).path(CENTRE)
    right = Push("spiral", angle, turns=1.0, mirrored=True).path(CENTRE)
    along = np.array([np.cos(angle), np.sin(angle)])
    offsets = left - CENTRE[:2]
    mirror = 2 * np.outer(offsets @ along, along) - offsets
    np.testing.assert_allclose(right - CENTRE[:2], mirror, atol=1e-12)


def test_a_straight_push_goes_the_same_way_about_a_target_that_is_seen_elsewhere():
    shift = np.array([0.004, -0.007, 0.003])
    for push in draw_pushes(20, np.random.default_rng(0)):
        moved = push.about(shift)
        assert moved.height + CENTRE[2] + shift[2] == pytest.approx(push.height + CENTRE[2])
        off = moved.path(CENTRE + shift) - push.path(CENTRE)
        if push.kind == "straight":
            np.testing.assert_allclose(off, 0, atol=1e-12)
        else:
            across = np.array([-np.sin(push.direction), np.cos(push.direction)])
            np.testing.assert_allclose(off @ across, 0, atol=1e-12)
            assert np.abs(off).max() <= np.linalg.norm(shift)


@given(st.integers(0, 2**32 - 1))
def test_random_pushes_stay_near_the_target_and_above_the_table(seed):
    for push in draw_pushes(5, np.random.default_rng(seed)):
        way = push.path(CENTRE)
        assert np.linalg.norm(way - CENTRE[:2], axis=1).max() < 0.35
        assert -0.012 <= push.height <= 0.035


def test_random_pushes_come_from_all_sides_and_in_all_shapes():
    pushes = draw_pushes(2000, np.random.default_rng(0))
    quarters = np.bincount([int(push.direction / (np.pi / 2)) for push in pushes])
    assert (np.abs(quarters / 500 - 1) < 0.2).all()
    spirals = [push for push in pushes if push.kind == "spiral"]
    assert 0.25 < len(spirals) / 2000 < 0.35
    assert 0.4 < np.mean([push.mirrored for push in spirals]) < 0.6
    assert {push.kind for push in pushes} == set(KINDS)


@pytest.mark.parametrize(
    ("push", "message"),
    [
        ({"kind": "loop", "turns": 1.0}, "unknown kind of push 'loop'.*straight, spiral"),
        ({"kind": "straight", "before": 0.05, "after": -0.05}, "has no length"),
        ({"kind": "spiral", "before": 0.1, "after": 0.1}, "has no length"),
    ],
)
def test_a_push_that_is_none_is_refused(push, message):
    with pytest.raises(MechSearchError, match=message):
        Push(direction=0.0, **push)
