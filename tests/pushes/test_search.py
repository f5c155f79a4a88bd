from dataclasses import replace

import numpy as np
import pytest

from mechsearch.pushes.chooser import PushChooser
from mechsearch.pushes.push import draw_places, draw_pushes, view_pushes

APART = np.array([[-0.1, 0.0, 0.05], [0.1, 0.0, 0.1]])
"""Two piles of one point each, too far apart to count for one another."""


class First(PushChooser):
    """Takes the first of what it draws."""

    def judge(self, pushes, sight):
        return -np.arange(float(len(pushes)))


@pytest.fixture
def searcher(camera):
    policy = First(camera, 40, searches=True)
    policy.reset(np.random.default_rng(0))
    return policy


def hidden(sight, centre):
    return replace(sight, target=np.zeros_like(sight.target), centre=centre, obstacles=APART)


def test_places_are_drawn_by_the_square_of_what_stands_there_and_less_where_it_was_looked():
    rng = np.random.default_rng(0)
    high = draw_places(4000, APART, [], rng)[:, 0] > 0
    assert high.mean() == pytest.approx(4 / 5, abs=0.02)
    looked = [np.array([0.1, 0.02])]
    again = draw_places(4000, APART, looked, rng)[:, 0] > 0
    assert again.mean() == pytest.approx(0.3 * 4 / (0.3 * 4 + 1), abs=0.025)


def test_a_push_at_a_place_looks_as_if_the_target_had_been_there(sight):
    at = replace(sight, target=np.zeros_like(sight.target), centre=np.array([0.05, -0.02, 0.03]))
    away = replace(at, centre=np.array([0.0, 0.0, 0.03]))
    pushes = draw_pushes(12, np.random.default_rng(1))
    moved = [replace(push, offset=(0.05, -0.02)) for push in pushes]
    here, there = view_pushes(pushes, at), view_pushes(moved, away)
    np.testing.assert_allclose(there.patches, here.patches, atol=2e-3)
    np.testing.assert_allclose(there.numbers[:, :9], here.numbers[:, :9], atol=1e-5)


def test_a_hidden_target_is_looked_for_all_over_the_heap(searcher, sight):
    unseen = hidden(sight, searcher._last_seen)
    drawn = searcher.draw(unseen, np.random.default_rng(0))
    places = unseen.centre[:2] + np.array([push.offset for push in drawn])
    nearest = np.abs(places[:, None] - APART[None, :, :2]).sum(axis=-1).argmin(axis=1)
    np.testing.assert_allclose(places, APART[nearest, :2], atol=1e-12)
    assert set(nearest) == {0, 1}


def test_one_that_was_seen_is_also_looked_for_there(searcher, sight):
    searcher._last_seen = np.array([0.0, 0.1, 0.03])
    drawn = searcher.draw(hidden(sight, searcher._last_seen), np.random.default_rng(0))
    assert [push.offset for push in drawn[:20]] == [(0.0, 0.0)] * 20
    assert all(abs(push.offset[1] + 0.1) < 1e-9 for push in drawn[20:])


def test_where_it_looked_is_remembered_until_the_next_episode(searcher, sight):
    unseen = hidden(sight, searcher._last_seen)
    push = searcher.draw(unseen, np.random.default_rng(0))[0]
    searcher.begin(push, unseen)
    searcher.begin(push, sight)
    np.testing.assert_allclose(searcher._looked, [unseen.centre[:2] + push.offset])
    searcher.reset(np.random.default_rng(0))
    assert searcher._looked == []


def test_a_visible_target_and_an_empty_table_need_no_search(searcher, sight):
    empty = replace(hidden(sight, searcher._last_seen), obstacles=np.zeros((0, 3)))
    for seen in (sight, empty):
        drawn = searcher.draw(seen, np.random.default_rng(3))
        assert drawn == draw_pushes(40, np.random.default_rng(3))
