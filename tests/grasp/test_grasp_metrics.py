import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mechsearch.grasp.metrics import auc, average_precision, judge, reliability
from mechsearch.types import MechSearchError


def test_hand_computed_scores():
    quality = np.array([0.9, 0.8, 0.7, 0.6])
    success = np.array([True, False, True, False])
    # Precision 1/1 at the first success and 2/3 at the second; 3 of 4 pairs in order.
    assert average_precision(quality, success) == pytest.approx((1 + 2 / 3) / 2)
    assert auc(quality, success) == pytest.approx(0.75)
    verdict = judge(quality, success)
    assert verdict.brier == pytest.approx((0.01 + 0.64 + 0.09 + 0.36) / 4)
    assert verdict.base_rate == 0.5


def test_equal_qualities_score_as_guessing():
    success = np.array([True, False, False, False])
    assert average_precision(np.full(4, 0.3), success) == pytest.approx(0.25)
    assert auc(np.full(4, 0.3), success) == pytest.approx(0.5)


@given(st.lists(st.tuples(st.floats(0, 1), st.booleans()), min_size=2, max_size=40))
def test_scores_agree_with_their_definitions(pairs):
    quality, success = np.array([q for q, _ in pairs]), np.array([s for _, s in pairs])
    if success.all() or not success.any():
        with pytest.raises(MechSearchError, match="expected some of both"):
            judge(quality, success)
        return
    verdict = judge(quality, success)
    won, lost = quality[success], quality[~success]
    order = np.sign(won[:, None] - lost[None]) / 2 + 0.5
    assert verdict.auc == pytest.approx(order.mean())
    precision = [success[quality >= q].mean() for q in won]
    assert verdict.average_precision == pytest.approx(np.mean(precision))
    bins = reliability(quality, success)
    assert bins[:, 2].sum() == len(pairs)
    assert 0 <= verdict.calibration_error <= 1


def test_shapes_must_fit():
    with pytest.raises(MechSearchError, match="differ in shape"):
        judge(np.zeros(3), np.zeros(4, np.bool_))
