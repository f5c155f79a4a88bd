from importlib import resources
from pathlib import Path

import pytest

from mechsearch.evaluation.rollout import EvaluationPlan, evaluate_plan
from mechsearch.grasp.network import load_network
from mechsearch.heaps.dataset import object_set
from mechsearch.retrieval.assessment import GraspabilityChange, assess_evaluation


def episodes(policy, limit):
    heaps = Path(str(resources.files("mechsearch.heaps") / "household_single.parquet"))
    return evaluate_plan(EvaluationPlan(policy, heaps, limit=limit))


def test_curves_have_the_bits_that_an_evaluation_of_the_same_episodes_measures():
    found = episodes("teacher-zigzag", 3)
    change = GraspabilityChange(load_network(), object_set("household"))
    changes = [change(record) for record in found.episodes]
    measured = assess_evaluation(found, objects="household").episodes
    assert changes == [record.grasp.after - record.grasp.before for record in measured]
    assert any(changes)
    # The start of a heap is rated once.
    assert [change(record) for record in found.episodes] == changes


def test_where_nothing_has_moved_nothing_is_rated():
    change = GraspabilityChange(None, object_set("household"))
    assert [change(record) for record in episodes("idle", 2).episodes] == [0, 0]
    with pytest.raises(AttributeError):
        change(episodes("teacher-straight", 1).episodes[0])
