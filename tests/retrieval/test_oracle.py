"""The ceiling of retrieval: what it tried is what happens."""

from dataclasses import replace

import numpy as np
import pytest

from mechsearch.env.decision import Decision
from mechsearch.env.retrieve_env import RetrieveEnv
from mechsearch.env.task import RetrieveConfig
from mechsearch.evaluation.rollout import Planner, evaluate, run_episode
from mechsearch.grippers import RatedGrasps
from mechsearch.retrieval import grasper as room
from mechsearch.retrieval.policies import OracleConfig, RetrieveOracle
from mechsearch.types import GRASP, PUSH, REMOVE, MechSearchError
from tests.retrieval.middle_planner import MiddlePlanner

SMALL = OracleConfig(grasps=3, pushes=3, removals=1, after=2)


@pytest.fixture(autouse=True)
def _by_middle(monkeypatch):
    monkeypatch.setattr(room, "GraspPlanner", MiddlePlanner)


@pytest.fixture
def play(covered, boxes):
    """Plays an episode; returns its decisions, its record, and the oracle."""

    def play(seed=0, **settings):
        policy = RetrieveOracle(SMALL)
        config = RetrieveConfig(keys=policy.keys, **settings)
        env = RetrieveEnv([covered], boxes, config)
        policy.equip(config.grippers)
        record = run_episode(policy, env, 0, seed)
        return [Decision.of(action) for action in record.actions], record, policy

    return play


@pytest.mark.parametrize("perturbed", [False, True])
@pytest.mark.parametrize("seed", [0, 1])
def test_every_grasp_that_worked_when_it_was_tried_works(play, perturbed, seed, monkeypatch):
    promised = []
    working = RetrieveOracle._working

    def spied(self, start, tried):
        found = working(self, start, tried)
        if found is not None:
            promised.append(found.tolist())
        return found

    monkeypatch.setattr(RetrieveOracle, "_working", spied)
    done, record, _ = play(seed, perturbed=perturbed)
    grasps = [d.vector().tolist() for d in done if d.kind == GRASP]
    # It had found a way, so the first grasp that is really made retrieves.
    assert promised
    assert len(grasps) == 1
    assert grasps[0] in promised
    assert record.end == "retrieved"


class VainPlanner(MiddlePlanner):
    """Grasps 10 cm above everything."""

    def plan(self, view, rng, count=3):
        rated = super().plan(view, rng, count)
        return RatedGrasps(rated.poses + np.array([0, 0, 0.1, 0, 0, 0, 0]), rated.quality)


def test_where_nothing_works_no_plan_goes_beyond_the_decisions_that_are_left(play, monkeypatch):
    monkeypatch.setattr(room, "GraspPlanner", VainPlanner)
    done, record, _ = play(max_removals=0, max_actions=12, max_grasps=2)
    assert [d.kind for d in done].count(PUSH) > 3
    assert "used up" not in record.retrieval.outcomes
    assert (done[-1].kind, record.end) == (GRASP, "budget")


def test_the_grasp_that_worked_after_a_plan_is_part_of_it(play, monkeypatch):
    """A planner that is good twice: for the lid, and for the cube once the lid is away."""
    calls = []

    def plan(self, view, rng, count=3):
        calls.append(1)
        kind = MiddlePlanner if len(calls) in (2, 3) else VainPlanner
        return kind.plan(kind("jaws-85"), view, rng, count)

    monkeypatch.setattr(room, "GraspPlanner", type("Moody", (MiddlePlanner,), {"plan": plan}))
    done, record, _ = play()
    assert [d.kind for d in done] == [REMOVE, GRASP]
    assert record.end == "retrieved"


def test_it_tries_with_the_decisions_that_are_left(play):
    done, record, policy = play(max_removals=0, max_actions=2, max_grasps=1)
    kinds = [d.kind for d in done]
    assert REMOVE not in kinds
    assert kinds.count(PUSH) <= 2
    assert kinds[-1] == GRASP
    assert "used up" not in record.retrieval.outcomes
    assert policy.simulated_actions > len(done)


def test_episodes_depend_on_the_seed_alone_and_trials_execute_nothing(play):
    (_, first, _), (_, second, _) = play(3), play(3)
    np.testing.assert_array_equal(first.actions, second.actions)
    np.testing.assert_array_equal(first.poses, second.poses)


def test_what_is_seen_in_a_trial_is_not_where_the_target_was_seen(covered, boxes):
    policy = RetrieveOracle(replace(SMALL, pushes=8))
    env = RetrieveEnv([covered], boxes, RetrieveConfig(keys=policy.keys, max_removals=0))
    policy.equip(("jaws-85",))
    obs, _ = env.reset(options={"heap": 0, "fixed_start": True})
    policy.reset(np.random.default_rng(0))
    policy.plan(env)
    before = env.snapshot()
    policy.act(obs)
    assert {k: v.tobytes() for k, v in env.snapshot().items()} == {
        k: v.tobytes() for k, v in before.items()
    }
    hidden = policy.grasper.view({**obs, "segments": np.zeros_like(obs["segments"])})
    last = policy.grasper.middle(hidden)
    np.testing.assert_array_equal(last, policy.grasper.middle(policy.grasper.view(obs)))


def test_it_needs_its_environment():
    policy = RetrieveOracle()
    policy.reset(np.random.default_rng(0))
    assert isinstance(policy, Planner)
    with pytest.raises(MechSearchError, match=r"expected plan\(env\) first"):
        policy.act({})


def test_it_is_evaluated_by_name_and_its_trials_are_counted_apart():
    found = evaluate("retrieve-oracle", limit=1)
    (record,) = found.episodes
    assert found.header["goal"] == "retrieve"
    assert found.header["simulated_actions"] > len(record.actions)
    assert record.retrieval is not None
