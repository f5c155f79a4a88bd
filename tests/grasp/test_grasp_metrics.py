import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mechsearch.grasp.learning.metrics import (
    auc,
    average_precision,
    judge,
    paired_gain,
    reliability,
)
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


@given(st.lists(st.tuples(st.floats(0, 1), st.booleans(), st.integers(0, 3)), min_size=1))
def test_a_weight_counts_as_so_many_copies(rows):
    quality, success, weight = (np.array(column) for column in zip(*rows, strict=True))
    if not weight[success].any():
        return
    copies = np.repeat(np.arange(len(rows)), weight)
    expected = average_precision(quality[copies], success[copies])
    assert average_precision(quality, success, weight) == pytest.approx(expected)


def test_a_network_gains_nothing_over_itself_and_much_over_guessing():
    rng = np.random.default_rng(1)
    success = rng.random(600) < 0.25
    good, blind = success + rng.normal(0, 0.5, 600), rng.random(600)
    heap = np.arange(600) // 10
    same = paired_gain(good, good, success, heap, 50)
    assert (same.mean, same.low, same.high) == (0.0, 0.0, 0.0)
    gain = paired_gain(good, blind, success, heap, 200)
    expected = average_precision(good, success) - average_precision(blind, success)
    assert gain.mean == pytest.approx(expected)
    assert 0 < gain.low < gain.mean < gain.high


def test_the_gain_of_one_lucky_heap_is_not_certain():
    """All the difference is in one heap of eight: the interval must hold zero."""
    rng = np.random.default_rng(2)
    success = rng.random(800) < 0.3
    heap = np.arange(800) // 100
    theirs = success + rng.normal(0, 1.0, 800)
    ours = np.where(heap == 0, success + 0.0, theirs)
    gain = paired_gain(ours, theirs, success, heap, 500)
    assert gain.mean > 0
    assert gain.low <= 0


def test_shapes_must_fit():
    with pytest.raises(MechSearchError, match="differ in shape"):
        judge(np.zeros(3), np.zeros(4, np.bool_))
