from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig
from mechsearch.evaluation.policies import LookAheadConfig, LookAheadPolicy, make_policy
from mechsearch.evaluation.rollout import EvaluationPlan, Planner, evaluate_plan, run
from mechsearch.heaps.dataset import embedded_heaps, save_heaps
from mechsearch.pushes.push import spiral, straight, zigzag
from mechsearch.teachers import PushTeacher


@pytest.fixture(scope="module")
def heap_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    embedded = embedded_heaps("single")
    path = tmp_path_factory.mktemp("heaps") / "three.parquet"
    save_heaps(path, embedded.held_out[:3], embedded.manifest)
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


@pytest.fixture
def env(covered, boxes) -> HeapEnv:
    env = HeapEnv([covered], boxes, HeapEnvConfig(privileged=True))
    env.reset(options={"heap": 0, "fixed_start": True})
    return env


def planned_push(env, config: LookAheadConfig) -> tuple[np.ndarray, int]:
    """Return the actions (T, 3) of the best push, and how many were simulated to find it."""
    policy = LookAheadPolicy(config)
    policy.reset(np.random.default_rng(0))
    policy.plan(env)
    taken = [policy.act({})]
    while taken[-1].any():
        taken.append(policy.act({}))
    return np.array(taken[:-1]), policy.simulated_actions


def test_the_plan_is_at_least_as_good_as_every_teachers_push_it_tried(env) -> None:
    snapshot = env.snapshot()
    config = LookAheadConfig(directions=4, gentleness=0.0, tolerance=0.0)
    actions, simulated = planned_push(env, config)
    planned = sum(env.step(action)[1] for action in actions)
    assert env.state.occlusion <= 0.02
    tried = 0
    for i in range(4):
        for shape in (straight, zigzag, spiral):
            teacher = PushTeacher(shape, np.pi / 2 * i)
            teacher.reset(np.random.default_rng([env.heap.seed, i]))
            obs, total, over = env.restore(snapshot), 0.0, False
            while not over:
                obs, reward, terminated, truncated, info = env.step(teacher.act(obs))
                total, over, tried = total + reward, terminated or truncated, tried + 1
            assert planned >= total - 1e-9 or info["end"] != "uncovered"
    assert len(actions) < simulated <= tried


def test_among_equals_the_push_that_sets_out_for_the_target_is_taken(env) -> None:
    obs = env.restore(env.snapshot())

    def directness(tolerance: float) -> float:
        config = LookAheadConfig(tolerance=tolerance, margin=1e9)
        actions, _ = planned_push(env, config)
        return float(actions[0] @ obs["target_offset"])

    assert directness(10.0) >= directness(1.0) >= directness(0.0)
    assert directness(10.0) > directness(0.0)


def test_it_is_no_worse_than_the_pushes_it_tries(covered, boxes) -> None:
    policy = LookAheadPolicy(LookAheadConfig(directions=4, gentleness=0.0, tolerance=0.0))
    env = HeapEnv([covered], boxes, HeapEnvConfig(keys=("ee_position",)))
    reward = run(policy, env, [0])[0].rewards.sum()
    watched = HeapEnv([covered], boxes, replace(env.config, privileged=True))
    for shape in (straight, zigzag, spiral):
        assert reward >= run(PushTeacher(shape, np.pi / 2), watched, [0])[0].rewards.sum() - 1e-9


def test_simulated_actions_are_counted_apart_whatever_the_number_of_workers(heap_file) -> None:
    plan = EvaluationPlan("look-ahead", heap_file)
    one, two = evaluate_plan(plan), evaluate_plan(plan, workers=2)
    assert one.header == two.header
    executed = sum(len(record.actions) for record in one.episodes)
    assert one.header["simulated_actions"] > 5 * executed
    assert "simulated_actions" not in evaluate_plan(EvaluationPlan("idle", heap_file)).header
