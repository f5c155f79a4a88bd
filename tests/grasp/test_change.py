from pathlib import Path

import numpy as np
import pytest

from mechsearch.grasp.change import ChangeTask, at_rest, measure
from mechsearch.sim.lift import Outcome


def at(x, y, z):
    return [x, y, z, 1.0, 0.0, 0.0, 0.0]


@pytest.fixture
def scene(make_box):
    """A bar, and a lid that may lie over it."""
    return [make_box("bar", (0.1, 0.03, 0.03)), make_box("lid", (0.16, 0.16, 0.02), 0.3)]


COVERED = np.array([at(0, 0, 0.015), at(0, 0, 0.04)])
CLEARED = np.array([at(0, 0, 0.015), at(0.25, 0, 0.01)])


def task(first, last):
    return ChangeTask(Path(), "boxes", ("bar", "lid"), 0, first, last)


def test_uncovering_makes_a_target_graspable_and_retrieved(released, scene):
    change = measure(released, scene, task(COVERED, CLEARED))
    assert change.before.score == 0.0
    assert change.retrieved_before is None
    assert change.after.score > 0.97
    assert change.retrieved_after is Outcome.SUCCESS
    assert change.alone.score == pytest.approx(change.after.score, abs=5e-3)


def test_a_lost_target_counts_zero_afterwards(released, scene):
    lost = np.array([at(0.6, 0, -0.7), at(0.2, 0, 0.01)])
    change = measure(released, scene, task(CLEARED, lost))
    assert change.after.lost
    assert change.retrieved_after is None
    assert change.after.score == 0.0
    assert change.before.score > 0.97
    assert change.retrieved_before is Outcome.SUCCESS


def test_the_end_is_measured_at_rest_without_the_robot(scene):
    in_the_air = np.array([at(0, 0, 0.015), at(0.25, 0, 0.06)])
    settled = at_rest(scene, in_the_air)
    assert settled[1, 2] == pytest.approx(0.01, abs=1e-3)
    np.testing.assert_allclose(settled[0], COVERED[0], atol=1e-3)
    gone = at_rest(scene, np.array([at(0.6, 0, -0.7), at(0.2, 0, 0.01)]))
    np.testing.assert_array_equal(gone[0], at(0.6, 0, -0.7))
