import numpy as np
import pytest

from mechsearch.grasp.graspability import Graspability
from mechsearch.retrieval.assessment import GraspAssessment, GraspTask, LiftResult, assess
from mechsearch.retrieval.calibration import calibrate
from mechsearch.types import MechSearchError, Outcome


def at(x, y, z):
    return [x, y, z, 1.0, 0.0, 0.0, 0.0]


def lifted(wins, repeats):
    outcomes = (Outcome.SUCCESS,) * wins + (Outcome.SLIPPED,) * (repeats - wins)
    return LiftResult(Outcome.SUCCESS, outcomes)


def trials(chance, heaps=120, grasps=20, repeats=5, seed=0):
    """Heaps, and grasps of uniform quality q on each that succeed with a chance of chance(q)."""
    rng = np.random.default_rng(seed)
    made = []
    for _ in range(heaps):
        quality = np.sort(rng.uniform(0.01, 0.99, grasps))[::-1]
        wins = rng.binomial(repeats, chance(quality))
        now = Graspability(float(quality[:10].mean()))
        lifts = tuple(lifted(won, repeats) for won in wins.tolist())
        made.append(GraspAssessment(now, None, quality, lifts))
    return range(heaps), made


def test_honest_qualities_are_left_as_they_are():
    found = calibrate(*trials(lambda q: q))
    assert found.slope == pytest.approx(1.0, abs=0.06)
    assert found.offset == pytest.approx(0.0, abs=0.06)
    assert found.threshold == pytest.approx(0.5, abs=0.02)
    # The expected squared error of an honest uniform chance is the mean of q (1 - q).
    assert found.brier == pytest.approx(1 / 6, abs=0.01)
    assert found.executions == 60 * 20 * 5
    np.testing.assert_allclose(found.curve[:, 0], found.curve[:, 1], atol=0.06)


def test_boastful_qualities_are_corrected_on_heaps_that_the_fit_has_not_seen():
    def truth(quality):
        odds = (quality / (1 - quality)) ** 2 * np.exp(-1.0)
        return odds / (1 + odds)

    found = calibrate(*trials(truth))
    assert found.slope == pytest.approx(2.0, abs=0.15)
    assert found.offset == pytest.approx(-1.0, abs=0.15)
    # One half where 2 logit(q) = 1, so where q = 1 / (1 + exp(-1 / 2)).
    assert found.threshold == pytest.approx(1 / (1 + np.exp(-0.5)), abs=0.02)
    assert found.brier_fitted < found.brier
    assert found.rank_correlation > 0.8


def test_qualities_that_say_nothing_correlate_with_nothing():
    found = calibrate(*trials(lambda q: np.full_like(q, 0.3)))
    assert abs(found.rank_correlation) < 0.1
    assert found.brier_fitted == pytest.approx(0.21, abs=0.01)


def test_a_half_without_both_outcomes_is_refused():
    with pytest.raises(MechSearchError, match="try more heaps"):
        calibrate(*trials(lambda q: np.ones_like(q)))
    with pytest.raises(MechSearchError, match="0 executions"):
        calibrate([1], [GraspAssessment(Graspability(), None, np.empty(0), ())])


def test_good_grasps_on_a_bar_alone_succeed_and_random_ones_less_often(released, make_box):
    models = [make_box("bar", (0.1, 0.03, 0.03))]
    plan = {"at_rest": False, "best": 10, "drawn": 10, "repeats": 5, "heap_seed": 7}
    task = GraspTask("boxes", ("bar",), np.array([at(0, 0, 0.015)]), 0, **plan)
    found = assess(released, models, task)
    wins = np.array([lift.wins for lift in found.lifts])
    assert len(found.quality) == len(wins) == 20
    assert found.now.score == pytest.approx(found.quality[:10].mean())
    assert wins[:10].mean() > 4
    assert wins[10:].mean() < wins[:10].mean() - 1
    lost = GraspTask("boxes", ("bar",), np.array([at(0.6, 0, -0.7)]), 0, **plan)
    assert assess(released, models, lost).now.score == 0.0
