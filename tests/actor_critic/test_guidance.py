from statistics import fmean, pvariance

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from mechsearch.actor_critic.guidance import (
    Belief,
    Guidance,
    GuidanceConfig,
    belief,
    probability_better,
)
from mechsearch.types import MechSearchError

values = st.floats(-50, 50)
variances = st.floats(0, 20)


def samples(*means, spread=0.01, count=50):
    """Q samples (count, M) around each candidate's mean."""
    return np.random.default_rng(0).normal(means, spread, (count, len(means)))


AC_TEACH = GuidanceConfig(threshold=0.6, decay=0.99, precision=10.0)


def committed_to(index, config=AC_TEACH):
    guidance = Guidance(config)
    means = np.zeros(3)
    means[index] = 10
    assert guidance.choose(samples(*means), np.random.default_rng(0)) == index
    return guidance


def test_the_first_choice_is_the_best_sample():
    assert Guidance(AC_TEACH).choose(samples(0, 5, 1), np.random.default_rng(0)) == 1


def test_switches_when_the_candidate_is_clearly_better():
    assert committed_to(0).choose(samples(0, 1, 0), np.random.default_rng(0)) == 1


def test_pushes_are_finished_unless_another_candidate_is_far_better():
    # In the end Phi(3 / sqrt(10)) = 0.829 exceeds 0.99 ** t, from t = 19 on.
    guidance, draws = committed_to(0, GuidanceConfig()), samples(0, 3, -5, spread=0)
    chosen = [guidance.choose(draws, np.random.default_rng(0)) for _ in range(25)]
    assert chosen == [0] * 19 + [1] * 6


def test_stays_when_the_candidate_is_clearly_worse():
    guidance = committed_to(0)
    draws = samples(5, 0, 0)
    draws[7] = (0, 1, 0)  # one draw in which a worse candidate looks best
    rng = _picks(7)
    assert guidance.choose(draws, rng) == 0
    assert guidance.overruled == 1


def test_stays_at_first_when_the_candidate_is_hardly_better():
    assert committed_to(0).choose(samples(0, 0.01, 0), np.random.default_rng(0)) == 0


def test_commitment_wears_off_as_better_samples_are_overruled():
    guidance = committed_to(0)
    draws = samples(0, 0.002, -5, spread=0)
    chosen = [guidance.choose(draws, np.random.default_rng(0)) for _ in range(25)]
    # Phi(0.002 / sqrt(0.1)) = 0.5025 exceeds 0.6 * 0.99 ** t from t = 18 on.
    assert chosen == [0] * 18 + [1] * 7


def test_only_overruled_actions_wear_commitment_off():
    guidance = committed_to(0)
    for _ in range(30):
        guidance.choose(samples(1, 0, 0), np.random.default_rng(0))
    assert guidance.overruled == 0


def test_an_episode_begins_uncommitted():
    guidance = committed_to(2)
    guidance.overruled = 3
    guidance.reset()
    assert guidance.current is None
    assert guidance.overruled == 0


def test_all_candidates_are_scored_by_one_draw():
    draws = np.array([[0.0, 1.0], [9.0, 8.0]])
    assert Guidance(AC_TEACH).choose(draws, _picks(1)) == 0
    assert Guidance(AC_TEACH).choose(draws, _picks(0)) == 1


def test_a_single_candidate_always_acts():
    guidance = Guidance(AC_TEACH)
    assert {guidance.choose(samples(3), np.random.default_rng(i)) for i in range(5)} == {0}


@given(values, variances, values, variances)
def test_probability_matches_the_normal_distribution(mean_a, var_a, mean_b, var_b):
    found = probability_better(Belief(mean_a, var_a), Belief(mean_b, var_b), precision=10)
    expected = norm.cdf((mean_a - mean_b) / np.sqrt(var_a + var_b + 0.1))
    assert found == pytest.approx(expected, abs=1e-12)


@given(values, variances, values, variances)
def test_the_two_probabilities_add_up_to_one(mean_a, var_a, mean_b, var_b):
    a, b = Belief(mean_a, var_a), Belief(mean_b, var_b)
    assert probability_better(a, b, 10) + probability_better(b, a, 10) == pytest.approx(1)


def test_a_better_mean_is_probably_better():
    assert probability_better(Belief(1.0, 0.1), Belief(0.0, 0.1), 10) == pytest.approx(
        0.966, abs=1e-3
    )


def test_a_belief_is_the_mean_and_variance_of_its_samples():
    assert belief(np.array([1.0, 3.0])) == Belief(2.0, 1.0)
    with pytest.raises(MechSearchError, match="at least one"):
        belief(np.zeros(0))


@pytest.mark.parametrize("wrong", [{"threshold": 2}, {"decay": 0}, {"precision": 0}])
def test_impossible_guidance_is_refused(wrong):
    with pytest.raises(MechSearchError, match="expected"):
        GuidanceConfig(**wrong)


@given(st.integers(0, 2**32 - 1), st.integers(2, 4), st.integers(1, 30))
def test_hands_change_to_the_better_and_never_to_the_worse(seed, candidates, turns):
    rng = np.random.default_rng(seed)
    guidance = Guidance(AC_TEACH)
    for _ in range(turns):
        draws = rng.normal(rng.normal(0, 2, candidates), rng.uniform(0.01, 3), (20, candidates))
        before, bar = guidance.current, 0.6 * 0.99**guidance.overruled
        row = int(rng.integers(20))
        after = guidance.choose(draws, _picks(row))
        best = max(range(candidates), key=lambda i: draws[row, i])
        if before is None:
            assert after == best
            continue
        means, variances = draws.mean(0), ((draws - draws.mean(0)) ** 2).mean(0)
        spread = np.sqrt(variances[best] + variances[before] + 0.1)
        better = norm.cdf((means[best] - means[before]) / spread) > bar
        assert after == (best if better else before)
        if after != before and bar >= 0.5:
            assert means[after] > means[before]


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=50))
def test_beliefs_agree_with_the_statistics_of_plain_lists(draws):
    found = belief(np.array(draws))
    assert found.mean == pytest.approx(fmean(draws), abs=1e-9)
    assert found.variance == pytest.approx(pvariance(draws), abs=1e-6)


class _picks:  # noqa: N801
    def __init__(self, row):
        self.row = row

    def integers(self, high):
        return self.row
