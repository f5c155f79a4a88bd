from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis.extra.numpy import arrays
from hypothesis.strategies import floats

from mechsearch.pushes.push import PlannedPush, Push, draw_pushes, straight
from mechsearch.pushes.route import Route, RouteConfig, approaches, steps_along
from mechsearch.types import ACTION_LENGTH, MechSearchError


def carried_out(planned, ee):
    """Return where the end effector comes, if nothing is in its way."""
    places = [np.array(ee)]
    while (action := planned.act({"ee_position": places[-1]})) is not None:
        assert np.linalg.norm(action) <= 1 + 1e-6
        places.append(places[-1] + ACTION_LENGTH * action)
        assert len(places) < 100
    return np.array(places)


@pytest.mark.parametrize("index", range(12))
def test_in_full_steps_every_action_but_the_last_has_full_length_and_is_along_the_way(sight, index):
    push = draw_pushes(12, np.random.default_rng(1), full_steps=True)[index]
    planned = PlannedPush(push, sight)
    places = carried_out(planned, sight.ee_position)
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    np.testing.assert_allclose(steps[:-1], ACTION_LENGTH, rtol=1e-5)
    np.testing.assert_allclose(places[-1], planned.way[-1], atol=0.012)
    # Every place lies on a leg of the way.
    start = planned.way[:1]
    over = approaches(start, sight.ee_position, sight.centre, sight.obstacles, FULL_STEPS)
    corners = np.vstack([over.corners[0], planned.way])
    legs = np.diff(corners, axis=0)
    along = np.einsum("pli,li->pl", places[:, None] - corners[:-1], legs)
    along = np.clip(along / np.maximum((legs * legs).sum(axis=1), 1e-12), 0, 1)
    nearest = corners[:-1] + along[..., None] * legs
    assert np.linalg.norm(places[:, None] - nearest, axis=-1).min(axis=1).max() < 0.013
    each = carried_out(PlannedPush(replace(push, full_steps=False), sight), sight.ee_position)
    assert len(places) <= len(each)
    assert 0 <= planned.approach + planned.length - len(steps) <= 3


FULL_STEPS = RouteConfig(travel_clearance=0.03, beside=0.035, above=0.02, full_steps=True)


def test_the_approach_in_full_steps_is_a_string_drawn_tight_over_what_lies_on_its_way():
    ee, starts = np.array([-0.15, 0.0, 0.1]), np.array([[0.15, 0.0, 0.04], [0.0, 0.3, 0.04]])
    # Halfway something 17 cm high; nearer to the start something lower, above the string's line to
    # the start but for the string itself; beside the way something high.
    middle, low, beside = [0.03, 0.03, 0.17], [0.09, 0.0, 0.07], [0.03, 0.04, 0.2]
    way = approaches(starts, ee, starts[0] * 0.9, np.array([middle, low, beside]), FULL_STEPS)
    np.testing.assert_array_equal(way.flies, [True, False])
    over, free = way.corners
    x = np.linspace(-0.15, 0.15, 16)
    # Up from 10 cm to 3 cm above the middle, 9 of 15 parts along, and down to 3 cm above the last.
    np.testing.assert_allclose(over[:, 0], x, atol=1e-12)
    np.testing.assert_allclose(over[:10, 2], np.linspace(0.1, 0.2, 10))
    assert over[14, 2] == pytest.approx(0.2 + (0.04 - 0.2) * 5 / 6)
    np.testing.assert_allclose(free, ee + np.linspace(0, 1, 16)[:, None] * (starts[1] - ee))


@settings(deadline=None)
@given(arrays(float, (3, 16), elements=floats(0, 0.24)))
def test_a_string_over_posts_bends_down_alone_and_hangs_on_posts(posts):
    ends = np.array([[0.0, 0.0, 0.1], [0.2, 0.1, 0.04], [0.1, 0.0, 0.1], [0.3, 0.0, 0.05]])
    share = np.linspace(0, 1, 16)
    for start, heights in zip(ends[1:], posts, strict=True):
        ground = ends[0, :2] + share[:, None] * (start - ends[0])[:2]
        objects = np.column_stack([ground, heights])
        way = approaches(start[None], ends[0], objects[0], objects[1:], FULL_STEPS)
        string = way.corners[0, :, 2]
        least = np.maximum(
            np.minimum(heights + 0.03, FULL_STEPS.highest),
            ends[0, 2] + share * (start[2] - ends[0, 2]),
        )
        assert (string >= least - 1e-12).all()
        bend = np.diff(string, 2)
        assert (bend <= 1e-12).all()
        # Where it bends, it lies on something.
        bends = 1 + np.nonzero(bend < -1e-9)[0]
        assert np.isin(np.round(string[bends], 9), np.round(least, 9)).all()


def test_full_steps_are_those_of_a_hand_drawn_corner():
    # 3 cm ahead and 6 up: after 5 cm it is 4 cm up, and 2 cm are left to the end.
    way = np.array([[0.03, 0.0, 0.0], [0.03, 0.06, 0.0]])
    expected = [[0.03, 0.04, 0.0], [0.03, 0.06, 0.0]]
    np.testing.assert_allclose(steps_along(np.zeros(3), way), expected, atol=1e-12)
    assert steps_along(np.zeros(3), way[:0]).shape == (0, 3)


@pytest.mark.parametrize("index", range(12))
def test_a_push_goes_through_its_waypoints_in_about_as_many_actions_as_planned(sight, index):
    push = draw_pushes(12, np.random.default_rng(1))[index]
    planned = PlannedPush(push, sight)
    places = carried_out(planned, sight.ee_position)
    for x, y in push.path(sight.centre):
        point = [x, y, planned.start[2]]
        assert np.linalg.norm(places - point, axis=1).min() < 0.03
    assert abs(len(places) - 1 - planned.approach - planned.length) <= 3


def test_a_push_ends_for_good(sight):
    planned = PlannedPush(Push("straight", 0.0, before=0.1, after=0.1), sight)
    last = {"ee_position": carried_out(planned, sight.ee_position)[-1]}
    assert planned.act(last) is None
    assert planned.act(last) is None


def test_the_approach_goes_over_what_stands_in_the_way_and_straight_where_nothing_does(sight):
    across = Push("straight", np.pi, before=0.15, after=0.05)
    over = PlannedPush(across, sight)
    places = carried_out(over, sight.ee_position)
    beside = np.linalg.norm(places[:, :2] - sight.obstacles[0, :2], axis=1) < 0.03
    assert over.flies
    assert (places[: int(over.approach)][beside[: int(over.approach)], 2] > 0.09).all()
    near = PlannedPush(Push("straight", 0.0, before=0.1, after=0.05), sight)
    assert not near.flies
    assert near.approach < over.approach


def test_the_fingertip_is_as_high_above_the_visible_target_as_the_push_says(sight):
    push = Push("straight", 0.0, before=0.1, after=0.05, height=0.03)
    assert PlannedPush(push, sight).start[2] == pytest.approx(0.07)
    low = replace(push, height=-0.04)
    assert PlannedPush(low, sight).start[2] == pytest.approx(0.02)


def test_a_push_needs_a_visible_target(sight):
    with pytest.raises(MechSearchError, match="visible"):
        PlannedPush(Push("spiral", 0.0, turns=1.0), replace(sight, centre=None))


TARGET, OTHERS = np.array([0.1, 0.0, 0.04]), np.array([[0.0, 0.0, 0.15]])


def test_a_route_goes_in_the_open_at_the_pushs_height_and_over_what_is_in_its_way():
    ee = np.array([-0.2, 0.0, 0.07])
    path = straight(TARGET[:2], np.pi, before=0.1, after=0.1)
    for others, heights in ((np.zeros((0, 3)), [0.07, 0.07]), (OTHERS, [0.24, 0.07, 0.07])):
        route = Route(RouteConfig(beside=0.08))
        route.begin(path, ee, np.array([0.1, 0.2, 0.04]), others)
        np.testing.assert_allclose(route.waypoints[:, 2], heights)
        np.testing.assert_allclose(route.push, [[0.2, 0.0, 0.07], [0.0, 0.0, 0.07]], atol=1e-12)


def test_a_route_stays_within_its_bounds_wherever_the_target_is():
    route = Route()
    target = np.array([0.28, -0.28, 0.3])
    route.begin(straight(target[:2], 0.3), np.zeros(3), target, np.zeros((0, 3)))
    assert np.abs(route.push[:, :2]).max() <= route.config.half
    assert route.push[:, 2].max() <= 0.2
    route.begin(straight(target[:2], 0.3), np.zeros(3), -target, np.zeros((0, 3)))
    np.testing.assert_allclose(route.push[:, 2], route.config.lowest)


def test_a_route_without_a_push_is_at_its_end():
    assert Route().next(np.zeros(3), TARGET, OTHERS) is None
