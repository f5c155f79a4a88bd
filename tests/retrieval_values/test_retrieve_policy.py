"""A policy that weighs pushes, removals and grasps."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn

from mechsearch.env.decision import Decision
from mechsearch.env.retrieve_env import RetrieveEnv
from mechsearch.env.task import RetrievalTask, RetrieveConfig
from mechsearch.retrieval import grasper as room
from mechsearch.retrieval.grasper import Candidate
from mechsearch.retrieval_values.algorithm import RetrievalValues
from mechsearch.retrieval_values.policy import RetrievePolicy, RetrievePolicyConfig
from mechsearch.retrieval_values.value import (
    OptionOutcomes,
    RetrievalValue,
    RetrievalValueConfig,
)
from mechsearch.retrieval_values.view import PushOption, RemovalOption
from mechsearch.training.run_directory import load_policy, save_policy, trained
from mechsearch.types import GRASP, PUSH, REMOVE, RETRIEVAL_KEYS, MechSearchError
from tests.retrieval.middle_planner import MiddlePlanner, segments_of

FREE = RetrievePolicyConfig(
    clearing=0.0, pushes=6, removals=2, action=0.0, removal=0.0, clutter=0.0, margin=0.0
)
SMALL = RetrievalValueConfig(filters=4, hidden=(16, 8))


class Says(nn.Module):
    """Promises a chance by the number of an option, and moved clutter."""

    def __init__(self, chances, moved=0.0):
        super().__init__()
        self.chances, self.moved = chances, moved

    def predict(self, patches, numbers):
        chance = torch.zeros(len(numbers))
        chance[: len(self.chances)] = torch.tensor(self.chances[: len(numbers)])
        return OptionOutcomes(chance, torch.full((len(numbers),), self.moved))


@pytest.fixture(autouse=True)
def _by_middle(monkeypatch):
    monkeypatch.setattr(room, "GraspPlanner", MiddlePlanner)


def policy_of(*networks, config=FREE, grippers=("jaws-85",)):
    policy = RetrievePolicy(networks, config)
    policy.equip(grippers)
    policy.reset(np.random.default_rng(0))
    return policy


@pytest.fixture
def env(covered, boxes):
    return RetrieveEnv([covered], boxes, RetrieveConfig(keys=RETRIEVAL_KEYS))


@pytest.fixture
def obs(env):
    return env.reset(options={"heap": 0, "fixed_start": True})[0]


def left(obs, pushes=50, removals=8):
    return {**obs, "pushes_left": np.array([pushes]), "removals_left": np.array([removals])}


def test_a_sure_grasp_is_made_at_once_whatever_else_is_promised(obs, monkeypatch):
    monkeypatch.setattr(MiddlePlanner, "quality", (0.9, 0.5, 0.4))
    decided = policy_of(Says([1.0] * 9)).decide(obs)
    assert isinstance(decided, Candidate)
    assert decided.quality == 0.9


@pytest.mark.parametrize("best", [0, 3])
def test_else_what_promises_most_is_done(obs, best):
    """The removal of the lid comes first, then the pushes; what stands apart is no option."""
    chances = [0.7] * 7
    chances[best] = 0.9
    policy = policy_of(Says(chances))
    options = policy_of(Says([])).options(obs, policy.grasper.view(obs))
    assert [type(option) for option in options] == [RemovalOption] + [PushOption] * 6
    policy.options = lambda *_: options
    assert policy.decide(obs) is options[best]


def test_networks_judge_together(obs):
    """Each has a favourite of its own; the third option is good to both."""
    policy = policy_of(Says([0.0, 0.9, 0.7]), Says([0.9, 0.0, 0.7]))
    view = policy.grasper.view(obs)
    situation = policy.situation(view, policy.grasper.candidates(view))
    worth = policy.judge(policy.options(obs, view), situation)
    np.testing.assert_allclose(worth[:3], [0.45, 0.45, 0.7], atol=1e-6)


def test_what_lies_on_the_target_is_worth_clearing_by_the_chance_of_its_grasp(obs):
    """The lid's best grasp promises 0.6, and every option 0.5."""
    policy = policy_of(Says([0.5] * 7), config=replace(FREE, clearing=0.5))
    view = policy.grasper.view(obs)
    situation = policy.situation(view, policy.grasper.candidates(view))
    worth = policy.judge(policy.options(obs, view), situation)
    np.testing.assert_allclose(worth, [0.5 + 0.5 * 0.6, *[0.5] * 6], atol=1e-6)


def test_an_object_whose_best_grasp_is_poor_is_no_option(obs):
    policy = policy_of(Says([0.5] * 7), config=replace(FREE, least=0.7))
    options = policy.options(obs, policy.grasper.view(obs))
    assert not any(isinstance(option, RemovalOption) for option in options)


def test_an_option_must_promise_more_than_the_grasp_by_a_margin_and_its_costs(obs):
    """The best grasp promises 0.6, and every option 0.7."""

    def decided(**costs):
        return policy_of(Says([0.7] * 7, 0.02), config=replace(FREE, **costs)).decide(obs)

    assert isinstance(decided(), RemovalOption)
    assert isinstance(decided(margin=0.09), RemovalOption)
    assert isinstance(decided(margin=0.11), Candidate)
    assert isinstance(decided(clutter=6.0), Candidate)
    assert isinstance(decided(removal=0.05), PushOption)
    assert isinstance(decided(action=0.05), RemovalOption)
    assert isinstance(decided(removal=0.11, action=0.11), Candidate)


def test_a_push_is_carried_to_its_end_before_anything_is_decided_again(env, obs):
    policy, decided = policy_of(Says([0.0] + [1.0] * 6)), []
    decide = policy.decide
    policy.decide = lambda obs: decided.append(decide(obs)) or decided[-1]
    actions = 0
    while len(decided) < 2:
        action = policy.act(obs)
        if len(decided) == 2:
            break
        assert action[0] == PUSH
        obs, *_ = env.step(action)
        actions += 1
    assert actions >= decided[0].actions - 1 > 0
    planned, seen = decided[0].begun(), env.reset(options={"heap": 0, "fixed_start": True})[0]
    for _ in range(actions):
        seen, *_ = env.step(Decision.push(planned.act(seen)).vector())
    assert planned.act(seen) is None


def test_a_push_is_given_up_where_no_push_is_left(env, obs):
    policy = policy_of(Says([0.0] + [1.0] * 6))
    assert policy.act(obs)[0] == PUSH
    assert policy.act(left(obs, pushes=0))[0] == GRASP
    # And it is not taken up again.
    again = policy_of(Says([0.0] + [1.0] * 6))
    again.act(obs)
    again.act(left(obs, pushes=0))
    assert again._push is None


def test_only_what_is_left_is_an_option(obs):
    policy = policy_of()
    view = policy.grasper.view(obs)
    kinds = [
        {type(option) for option in policy.options(left(obs, *counts), view)}
        for counts in ((0, 0), (1, 0), (0, 1))
    ]
    assert kinds == [set(), {PushOption}, {RemovalOption}]


def test_what_was_put_aside_is_not_tried_again_where_it_lay(obs):
    policy = policy_of(Says([1.0]))
    first = policy.decide(obs)
    assert isinstance(first, RemovalOption)
    view = policy.grasper.view(obs)
    others = [o for o in policy.options(obs, view) if isinstance(o, RemovalOption)]
    # The best grasp of the same object that lies elsewhere, if any.
    assert all(np.linalg.norm(o.grasp.pose - first.grasp.pose) > 0.015 for o in others)
    policy.reset(np.random.default_rng(0))
    again = policy.decide(obs)
    np.testing.assert_array_equal(again.grasp.pose, first.grasp.pose)


def hidden(obs, *boxes):
    return {**obs, **segments_of(*boxes), "position_image": np.zeros_like(obs["position_image"])}


LOW, HIGH = (2, (230, 262), (230, 280), 0.72), (3, (262, 280), (230, 280), 0.66)
APART = (4, (50, 90), (50, 90), 0.6)


def test_of_a_hidden_target_the_highest_that_lies_where_it_was_goes_first(obs):
    policy = policy_of(Says([]))
    decided = policy.decide(hidden(obs, LOW, HIGH, APART))
    assert isinstance(decided, RemovalOption)
    assert decided.height == pytest.approx(0.8 - 0.66, abs=1e-6)
    # In the middle of the heap, as it was never seen; afterwards where it was last.
    policy.reset(np.random.default_rng(0))
    policy.decide({**obs, **segments_of((1, (95, 110), (60, 80), 0.7), LOW)})
    decided = policy.decide(hidden(obs, LOW, HIGH, APART))
    assert decided.height == pytest.approx(0.8 - 0.6, abs=1e-6)


def test_a_hidden_target_is_pushed_for_and_at_last_grasped_blindly(obs):
    policy, seen = policy_of(Says([])), hidden(obs, LOW, HIGH)
    pushed = policy.decide(left(seen, removals=0))
    assert isinstance(pushed, PushOption)
    np.testing.assert_allclose(pushed.sight.centre, [0, 0, 0.03])
    blind = policy.decide(left(seen, 0, 0))
    assert isinstance(blind, Candidate)
    assert blind.quality == 0.0
    np.testing.assert_allclose(blind.pose[:3], [0, 0, 0.01], atol=1e-9)


def test_decisions_follow_from_the_generator_and_from_its_own_keys(obs):
    policy = policy_of()
    assert policy.keys == RETRIEVAL_KEYS
    actions = []
    for seed, seen in ((0, obs), (0, {**obs, "occlusion": np.array([0.0])}), (1, obs)):
        policy.reset(np.random.default_rng(seed))
        actions.append([policy.act(seen).tolist() for _ in range(3)])
    assert actions[0] == actions[1] != actions[2]


def test_kinds_of_decisions_are_vectors_of_their_kind(obs):
    assert policy_of(Says([1.0])).act(obs)[0] == REMOVE
    assert policy_of(Says([0.0, 1.0])).act(obs)[0] == PUSH
    assert policy_of(Says([])).act(obs)[0] == GRASP


@pytest.mark.parametrize("count", [0, 2])
def test_a_saved_policy_is_the_same_policy(tmp_path, obs, count):
    torch.manual_seed(0)
    networks, file = [RetrievalValue(SMALL) for _ in range(count)], tmp_path / "actor.safetensors"
    policy = policy_of(*networks, config=replace(FREE, sure=0.7))
    save_policy(trained(policy, RetrievalValues(), 123, RetrievalTask()), file)
    loaded = load_policy(file)
    assert (loaded.goal, loaded.training_actions, loaded.camera) == ("retrieve", 123, "overhead")
    loaded.equip(("jaws-85",))
    loaded.reset(np.random.default_rng(0))
    assert loaded.policy.config == policy.config
    for _ in range(3):
        np.testing.assert_array_equal(loaded.act(obs), policy.act(obs))


def test_damaged_weights_are_refused(tmp_path):
    file = tmp_path / "actor.safetensors"
    policy = policy_of(RetrievalValue(SMALL))
    save_policy(trained(policy, RetrievalValues(), 123, RetrievalTask()), file)
    data = bytearray(file.read_bytes())
    data[-5] ^= 1
    file.write_bytes(data)
    with pytest.raises(MechSearchError, match="damaged"):
        load_policy(file)


def test_settings_out_of_range_are_refused():
    for wrong in ({"pushes": -1}, {"removals": -1}, {"proposals": 0}):
        (name,) = wrong
        with pytest.raises(MechSearchError, match=f"{name} is .*expected at least"):
            RetrievePolicyConfig(**wrong)
