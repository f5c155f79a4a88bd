import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mechsearch.evaluation.episodes import (
    METRICS,
    GraspRecord,
    mean_interval,
    measure,
    score,
    score_by_count,
    share_interval,
)
from mechsearch.types import MechSearchError


def test_metrics_of_an_episode_match_hand_computed_numbers(make_episode) -> None:
    episode = make_episode(
        length=2,
        occlusions=np.array([0.6, 0.4, 0.0]),
        reward_terms={"visibility": np.array([1.0, 2.5]), "idleness": np.array([-0.5, -0.5])},
        clutter_moved=np.array([0.01, 0.03]),
        target_moved=np.array([0.0, 0.002]),
        end="uncovered",
    )
    assert measure(episode) == pytest.approx(
        {
            "reward": 2.5,
            "visibility_change": 0.6,
            "uncovered_rate": 1.0,
            "episode_actions": 2.0,
            "clutter_moved_m": 0.04,
            "target_moved_m": 0.002,
            "term_visibility": 3.5,
            "term_idleness": -1.0,
        }
    )


def test_a_tried_grasp_adds_its_hand_computed_metrics(make_episode) -> None:
    values = measure(make_episode(grasp=GraspRecord(0.25, 0.75, 0.9, "", "success")))
    assert values["graspability_change"] == 0.5
    assert (values["retrieval_before"], values["retrieval_after"]) == (0.0, 1.0)
    dropped = measure(make_episode(grasp=GraspRecord(0.75, 0.0, 0.9, "success", "dropped")))
    assert dropped["graspability_change"] == -0.75
    assert (dropped["retrieval_before"], dropped["retrieval_after"]) == (1.0, 0.0)


def test_retrieval_is_scored_as_a_share_of_all_episodes(make_episode) -> None:
    tried = [GraspRecord(0.1, 0.2, 0.3, "", end) for end in ("success", "missed", "", "success")]
    episodes = [make_episode(i, grasp=grasp) for i, grasp in enumerate(tried)]
    assert score(episodes)["retrieval_after"] == share_interval([1, 0, 0, 1])


def test_grasps_are_tried_in_all_episodes_or_none(make_episode) -> None:
    mixed = [make_episode(0), make_episode(1, grasp=GraspRecord(0.1, 0.2, 0.3, "", ""))]
    with pytest.raises(MechSearchError, match="tried in 1 of 2 episodes"):
        score(mixed)


@pytest.mark.parametrize("end", ["action limit", "lost", "failure: NaN"])
def test_an_unfinished_episode_counts_all_its_actions(make_episode, end: str) -> None:
    values = measure(make_episode(length=3, end=end))
    assert values["episode_actions"] == 50
    assert values["uncovered_rate"] == 0


def test_every_episode_stays_in_every_mean(make_episode) -> None:
    ends = ["uncovered", "action limit", "lost", "failure: NaN"]
    scores = score(make_episode(i, end=end) for i, end in enumerate(ends))
    assert {estimate.heaps for estimate in scores.values()} == {4}
    assert scores["uncovered_rate"].mean == 0.25
    assert set(METRICS) < set(scores)


def test_a_number_that_cannot_be_averaged_is_refused(make_episode) -> None:
    episode = make_episode(9, length=1, target_moved=np.array([np.nan]))
    with pytest.raises(MechSearchError, match="target_moved_m of random on heap 9 is nan"):
        measure(episode)


def test_t_interval_matches_a_textbook_example() -> None:
    # t(0.975, 4) = 2.776; the standard deviation of 1..5 is sqrt(2.5).
    estimate = mean_interval([1, 2, 3, 4, 5])
    half = 2.7764451 * np.sqrt(2.5) / np.sqrt(5)
    assert (estimate.mean, estimate.heaps) == (3, 5)
    assert (estimate.ci_low, estimate.ci_high) == pytest.approx((3 - half, 3 + half))


def test_wilson_interval_matches_published_numbers() -> None:
    # Newcombe (1998), table I: 81 of 263, 15 of 148, 0 of 20.
    for successes, n, low, high in [
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
    ]:
        estimate = share_interval(np.arange(n) < successes)
        assert (estimate.ci_low, estimate.ci_high) == pytest.approx((low, high), abs=5e-5)


@given(st.integers(0, 60), st.integers(1, 60))
def test_a_share_lies_inside_its_interval_inside_the_unit_interval(k: int, n: int) -> None:
    estimate = share_interval(np.arange(n) < k)
    assert 0 <= estimate.ci_low <= estimate.mean <= estimate.ci_high <= 1


def test_intervals_cover_the_truth_in_95_of_100_samples() -> None:
    rng = np.random.default_rng(0)
    samples = rng.normal(3, 2, (2000, 12))
    covered = [(e := mean_interval(x)).ci_low <= 3 <= e.ci_high for x in samples]
    assert np.mean(covered) == pytest.approx(0.95, abs=0.015)


def test_one_heap_has_no_interval() -> None:
    estimate = mean_interval([4.0])
    assert estimate.mean == 4
    assert np.isnan([estimate.ci_low, estimate.ci_high]).all()


def test_scores_by_count_partition_the_heaps(make_episode) -> None:
    records = [make_episode(i, count=count) for i, count in enumerate([15, 5, 5, 10])]
    scores = score_by_count(records)
    assert list(scores) == [5, 10, 15]
    assert [scores[count]["reward"].heaps for count in scores] == [2, 1, 1]
    assert scores[15]["reward"].mean == measure(records[0])["reward"]


def test_no_episode_has_no_score() -> None:
    with pytest.raises(MechSearchError, match="no episode to score"):
        score([])
