from dataclasses import replace

import numpy as np
import pytest

from mechsearch.pushes import Push, PushFollower, draw_pushes
from mechsearch.types import ACTION_LENGTH, MechSearchError


def carried_out(follower, ee):
    """Return where the end effector comes, if nothing is in its way."""
    places = [np.array(ee)]
    while (action := follower.next(places[-1])) is not None:
        assert np.linalg.norm(action) <= 1 + 1e-6
        places.append(places[-1] + ACTION_LENGTH * action)
        assert len(places) < 100
    return np.array(places)


@pytest.mark.parametrize("index", range(12))
def test_a_push_goes_through_its_waypoints_in_about_as_many_actions_as_planned(sight, index):
    push = draw_pushes(12, np.random.default_rng(1))[index]
    follower = PushFollower(push, sight)
    wanted = push.path(sight.centre, follower.start[2])
    places = carried_out(follower, sight.ee_position)
    for point in wanted:
        assert np.linalg.norm(places - point, axis=1).min() < 0.03
    assert abs(len(places) - 1 - follower.approach - follower.length) <= 3


def test_a_push_ends_for_good(sight):
    follower = PushFollower(Push("straight", 0.0, before=0.1, after=0.1), sight)
    last = carried_out(follower, sight.ee_position)[-1]
    assert follower.next(last) is None
    assert follower.next(last) is None


def test_the_approach_goes_over_what_stands_in_the_way_and_straight_where_nothing_does(sight):
    across = Push("straight", np.pi, before=0.15, after=0.05)
    over = PushFollower(across, sight)
    places = carried_out(over, sight.ee_position)
    beside = np.linalg.norm(places[:, :2] - sight.obstacles[0, :2], axis=1) < 0.03
    assert over.flies
    assert (places[: int(over.approach)][beside[: int(over.approach)], 2] > 0.09).all()
    near = PushFollower(Push("straight", 0.0, before=0.1, after=0.05), sight)
    assert not near.flies
    assert near.approach < over.approach


def test_the_fingertip_is_as_high_above_the_visible_target_as_the_push_says(sight):
    push = Push("straight", 0.0, before=0.1, after=0.05, height=0.03)
    assert PushFollower(push, sight).start[2] == pytest.approx(0.07)
    low = replace(push, height=-0.04)
    assert PushFollower(low, sight).start[2] == pytest.approx(0.02)


def test_a_push_needs_a_visible_target(sight):
    with pytest.raises(MechSearchError, match="visible"):
        PushFollower(Push("spiral", 0.0, turns=1.0), replace(sight, centre=None))
