import numpy as np
import pytest

from mechsearch.grasp.graspability import BEST, ceiling, graspability
from mechsearch.types import MechSearchError


def pose(x, y, z):
    return [x, y, z, 1.0, 0.0, 0.0, 0.0]


@pytest.fixture
def bar(make_box):
    return make_box("bar", (0.1, 0.03, 0.03))


def test_the_released_network_knows_what_its_gripper_holds(released, make_box):
    score = {
        width: ceiling(released, make_box("b", (0.1, width, 0.04)), pose(0, 0, 0.02)).score
        for width in (0.03, 0.05, 0.07)
    }
    assert score[0.03] > 0.97
    assert score[0.05] > 0.95
    assert score[0.07] < 0.2
    assert ceiling(released, make_box("flat", (0.1, 0.03, 0.008)), pose(0, 0, 0.004)).score < 0.05


def test_neighbours_on_both_sides_take_graspability_away(released, bar, make_box):
    walls = [make_box(f"w{i}", (0.14, 0.03, 0.03)) for i in range(2)]

    def score(gap):
        side = 0.03 + gap
        poses = [pose(0, 0, 0.015), pose(0, side, 0.015), pose(0, -side, 0.015)]
        return graspability(released, [bar, *walls], np.array(poses), 0).score

    assert score(0.005) < 0.1
    assert score(0.04) > 0.95


def test_a_target_near_the_edge_of_the_table_scores_like_one_in_the_middle(released, bar):
    middle = graspability(released, [bar], np.array([pose(0, 0, 0.015)]), 0)
    edge = graspability(released, [bar], np.array([pose(0.35, -0.35, 0.015)]), 0)
    assert edge.score == pytest.approx(middle.score, abs=2e-3)
    assert edge.visible == middle.visible


def test_a_hidden_target_counts_zero(untrained, bar, make_box):
    lid = make_box("lid", (0.2, 0.2, 0.02))
    found = graspability(untrained, [bar, lid], np.array([pose(0, 0, 0.015), pose(0, 0, 0.05)]), 0)
    assert (found.score, found.diverse, found.visible) == (0.0, 0.0, 0)
    assert found.best is None
    assert not found.lost


def test_a_lost_target_counts_zero_and_is_flagged(untrained, bar):
    found = graspability(untrained, [bar], np.array([pose(0.6, 0, -0.7)]), 0)
    assert (found.score, found.lost) == (0.0, True)


def test_clutter_that_left_the_table_does_not_count(untrained, bar, make_box):
    lid = make_box("lid", (0.2, 0.2, 0.02))
    poses = np.array([pose(0.6, 0, 0.05), pose(0, 0, 0.015)])
    with_lid = graspability(untrained, [lid, bar], poses, 1)
    assert with_lid.score == ceiling(untrained, bar, poses[1]).score


def test_the_score_is_the_mean_of_the_ten_best(untrained, bar):
    found = graspability(untrained, [bar], np.array([pose(0, 0, 0.015)]), 0)
    assert BEST == 10
    assert found.best is not None
    assert found.diverse <= found.score <= 1.0


def test_poses_that_do_not_fit_are_refused(untrained, bar):
    with pytest.raises(MechSearchError, match="do not fit 1 objects"):
        graspability(untrained, [bar], np.zeros((2, 7)), 0)
