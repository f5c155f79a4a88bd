import json
from dataclasses import replace

import numpy as np
import pytest

from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig
from mechsearch.env.register import embedded_heaps
from mechsearch.evaluation.look_ahead import LookAhead, LookAheadConfig
from mechsearch.heaps.dataset import save
from mechsearch.teachers import make_teachers
from mechsearch.train.expert import (
    DemonstrateConfig,
    LookAheadExpert,
    demonstrate,
    failed,
    spread_over_counts,
)
from mechsearch.types import ACTOR_KEYS, MechSearchError
from mechsearch.workers import Failure


@pytest.fixture
def env(covered, boxes):
    return HeapEnv([covered], boxes, HeapEnvConfig(privileged=True))


def test_the_plan_is_at_least_as_good_as_every_teachers_push_it_tried(env, covered, boxes):
    env.reset(options={"heap": 0, "fixed_start": True})
    snapshot = env.snapshot()
    config = LookAheadConfig(directions=4, gentleness=0.0, tolerance=0.0)
    plan = LookAhead([covered], boxes, env.config, config).plan(snapshot, 0)
    tried = 0
    for i in range(4):
        for teacher in make_teachers(np.pi / 2 * i).values():
            teacher.reset(np.random.default_rng([0, i]))
            obs, total, over = env.restore(snapshot), 0.0, False
            while not over:
                obs, reward, terminated, truncated, info = env.step(teacher.act(obs))
                total, over, tried = total + reward, terminated or truncated, tried + 1
            assert plan.reward >= total - 1e-9 or info["end"] != "uncovered"
    assert len(plan.actions) < plan.simulated_actions <= tried


def test_among_equals_the_push_that_sets_out_for_the_target_is_taken(env, covered, boxes):
    env.reset(options={"heap": 0, "fixed_start": True})
    snapshot = env.snapshot()
    obs = env.restore(snapshot)

    def directness(tolerance):
        config = LookAheadConfig(tolerance=tolerance, margin=1e9)
        plan = LookAhead([covered], boxes, env.config, config).plan(snapshot, 0)
        return float(plan.actions[0] @ obs["target_offset"])

    assert directness(10.0) >= directness(1.0) >= directness(0.0)
    assert directness(10.0) > directness(0.0)


def test_what_was_planned_happens(env):
    env.reset(options={"heap": 0, "fixed_start": True})
    expert = LookAheadExpert(env, LookAheadConfig(directions=4))
    shown, simulated = expert(env)
    assert env.state.occlusion <= 0.02
    assert shown is not None
    assert simulated == shown.simulated_actions > shown.executed_actions == len(shown.action)
    assert shown.obs["depth"].shape == (len(shown.action), 1, 64, 64)


def test_indices_alternate_between_object_counts():
    assert spread_over_counts([5, 5, 10, 10, 15, 15], 0, 4) == [0, 2, 4, 1]


@pytest.fixture(scope="module")
def heap_file(tmp_path_factory):
    embedded = embedded_heaps("single")
    path = tmp_path_factory.mktemp("heaps") / "two.parquet"
    save(path, [replace(heap, held_out=False) for heap in embedded.heaps[:2]], embedded.manifest)
    return path


def test_demonstrations_are_recorded_once_and_the_same_again(heap_file, tmp_path):
    config = DemonstrateConfig(heap_file, look_ahead=LookAheadConfig(directions=2))
    store = demonstrate(config, tmp_path / "one")
    again = demonstrate(config, tmp_path / "two")
    assert len(store.names()) + len(failed(store.path)) == 2
    assert store.names() == again.names()
    for name in store.names():
        first, second = store.read(name), again.read(name)
        np.testing.assert_array_equal(first.action, second.action)
        for key in ACTOR_KEYS:
            np.testing.assert_array_equal(first.obs[key], second.obs[key])
    told = []
    demonstrate(config, tmp_path / "one", progress=lambda *words: told.append(words))
    assert told == [("demonstrated heaps", 2, 2)]
    other = replace(config, seed=1)
    with pytest.raises(MechSearchError, match="seed 0"):
        demonstrate(other, tmp_path / "one")


def test_a_heap_that_kills_two_workers_counts_as_failed_and_its_file_says_why(heap_file, tmp_path):
    def deadly(function, inputs, workers, time_limit, instead):
        return (instead(name, Failure("worker died")) for name in inputs)

    store = demonstrate(DemonstrateConfig(heap_file), tmp_path / "one", mapper=deadly)
    assert sorted(failed(store.path)) == ["0-000000", "0-000001"]
    record = json.loads((store.path / "0-000000.failed.json").read_text())
    assert record == {"simulated_actions": 0, "failure": "worker died"}
