import numpy as np
import pytest

from mechsearch.retrieval.assessment import GraspTask, assess, settled
from mechsearch.types import Outcome


def at(x, y, z):
    return [x, y, z, 1.0, 0.0, 0.0, 0.0]


@pytest.fixture
def scene(make_box):
    """A bar, and a lid that may lie over it."""
    return [make_box("bar", (0.1, 0.03, 0.03)), make_box("lid", (0.16, 0.16, 0.02), 0.3)]


COVERED = np.array([at(0, 0, 0.015), at(0, 0, 0.04)])
CLEARED = np.array([at(0, 0, 0.015), at(0.25, 0, 0.01)])


def task(poses, **options):
    return GraspTask("boxes", ("bar", "lid"), poses, 0, **options)


def test_uncovering_makes_a_target_graspable_and_retrieved(released, scene):
    covered = assess(released, scene, task(COVERED, alone=True))
    assert covered.now.score == 0.0
    assert covered.retrieved is None
    cleared = assess(released, scene, task(CLEARED, at_rest=False))
    assert cleared.now.score > 0.97
    assert cleared.retrieved is Outcome.SUCCESS
    assert cleared.alone is None
    assert covered.alone.score == pytest.approx(cleared.now.score, abs=5e-3)


def test_a_lost_target_counts_zero(released, scene):
    lost = assess(
        released, scene, task(np.array([at(0.6, 0, -0.7), at(0.2, 0, 0.01)]), at_rest=False)
    )
    assert lost.now.lost
    assert lost.now.score == 0.0
    assert lost.retrieved is None


def test_the_end_is_measured_at_rest_without_the_robot(scene):
    in_the_air = np.array([at(0, 0, 0.015), at(0.25, 0, 0.06)])
    found = settled(scene, in_the_air)
    assert found[1, 2] == pytest.approx(0.01, abs=1e-3)
    np.testing.assert_allclose(found[0], COVERED[0], atol=1e-3)
    gone = settled(scene, np.array([at(0.6, 0, -0.7), at(0.2, 0, 0.01)]))
    np.testing.assert_array_equal(gone[0], at(0.6, 0, -0.7))
