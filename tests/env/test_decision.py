"""Decisions as records, vectors and a space."""

import numpy as np
import pytest

from mechsearch.env.decision import GRASP, PUSH, REMOVE, Decision, DecisionSpace
from mechsearch.sim.scene import Workspace
from mechsearch.types import MechSearchError

POSE = (0.1, -0.2, 0.03, 0.6, 0.0, 0.0, 0.8)


@pytest.mark.parametrize(
    ("decision", "vector"),
    [
        (Decision.push([1.0, -0.5, 0.0]), [PUSH, 0, 1.0, -0.5, 0, 0, 0, 0, 0]),
        (Decision.grasp(POSE), [GRASP, 0, *POSE]),
        (Decision.remove(POSE, gripper=1), [REMOVE, 1, *POSE]),
    ],
)
def test_a_decision_and_its_vector_say_the_same(decision, vector):
    np.testing.assert_array_equal(decision.vector(), vector)
    assert Decision.of(decision.vector()) == decision


@pytest.mark.parametrize(
    ("vector", "message"),
    [
        (np.zeros(3), r"is \(9,\) finite.*got shape \(3,\)"),
        ([3, 0, *POSE], r"kind 3; expected 0 \(push\), 1 \(grasp of the target\) or 2"),
        ([0.5, 0, *POSE], "kind 0.5 by gripper 0.0; expected whole numbers"),
        ([GRASP, 0, *POSE[:3], 1.0, 1.0, 0.0, 0.0], "quaternion.*expected length 1"),
        ([PUSH, 0, np.nan, *POSE[:6]], "finite numbers"),
    ],
)
def test_what_is_no_decision_is_refused(vector, message):
    with pytest.raises(MechSearchError, match=message):
        Decision.of(np.array(vector, np.float64))


def test_samples_are_decisions_of_all_kinds_and_the_space_contains_them():
    space = DecisionSpace(2, Workspace())
    space.seed(0)
    samples = [space.sample() for _ in range(60)]
    assert all(space.contains(sample) for sample in samples)
    assert {Decision.of(sample).kind for sample in samples} == {PUSH, GRASP, REMOVE}
    assert {Decision.of(sample).gripper for sample in samples} == {0, 1}
    assert not space.contains(np.full(9, 0.5))
    assert not space.contains("push")
