from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig
from mechsearch.env.register import embedded_heaps
from mechsearch.evaluation.look_ahead import LookAheadConfig, LookAheadPolicy, Planner
from mechsearch.evaluation.policies import make_policy
from mechsearch.evaluation.rollout import EvaluationPlan, evaluate, run
from mechsearch.heaps.dataset import save
from mechsearch.teachers import make_teachers


@pytest.fixture(scope="module")
def heap_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    embedded = embedded_heaps("single")
    path = tmp_path_factory.mktemp("heaps") / "three.parquet"
    save(path, embedded.held_out[:3], embedded.manifest)
    return path


def test_the_look_ahead_is_a_policy_that_plans_and_the_others_are_not() -> None:
    assert isinstance(make_policy("look-ahead"), Planner)
    assert not isinstance(make_policy("teacher-straight"), Planner)


def test_the_episode_is_the_plan_and_the_world_is_where_it_was(covered, boxes) -> None:
    env = HeapEnv([covered], boxes, HeapEnvConfig(keys=("ee_position",)))
    policy = LookAheadPolicy(LookAheadConfig(directions=4))
    first, again = run(policy, env, [0, 0])
    assert first.uncovered
    np.testing.assert_array_equal(first.actions, again.actions)
    np.testing.assert_array_equal(first.poses[0], covered.poses)
    assert policy.simulated_actions > len(first.actions)


def test_it_is_no_worse_than_the_pushes_it_tries(covered, boxes) -> None:
    policy = LookAheadPolicy(LookAheadConfig(directions=4, gentleness=0.0, tolerance=0.0))
    env = HeapEnv([covered], boxes, HeapEnvConfig(keys=("ee_position",)))
    reward = run(policy, env, [0])[0].rewards.sum()
    watched = HeapEnv([covered], boxes, replace(env.config, privileged=True))
    for teacher in make_teachers(np.pi / 2).values():
        assert reward >= run(teacher, watched, [0])[0].rewards.sum() - 1e-9


def test_simulated_actions_are_counted_apart_whatever_the_number_of_workers(heap_file) -> None:
    plan = EvaluationPlan("look-ahead", heap_file)
    one, two = evaluate(plan), evaluate(plan, workers=2)
    assert one.header == two.header
    executed = sum(len(record.actions) for record in one.episodes)
    assert one.header["simulated_actions"] > 5 * executed
    assert "simulated_actions" not in evaluate(EvaluationPlan("idle", heap_file)).header
