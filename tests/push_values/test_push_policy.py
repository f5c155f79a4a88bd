from dataclasses import replace

import numpy as np
import pytest
import torch

from mechsearch.actor_critic.algorithm import ActorCritic
from mechsearch.actor_critic.networks import Actor, NetworkConfig
from mechsearch.actor_critic.policy import ActorPolicy
from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig, TaskConfig
from mechsearch.evaluation.rollout import run_episode
from mechsearch.files.tensors import Archive, save_archive
from mechsearch.push_values.algorithm import PushValues
from mechsearch.push_values.policy import PushPolicy, PushPolicyConfig
from mechsearch.push_values.value import Continuation, PushValue, PushValueConfig
from mechsearch.pushes.push import draw_pushes, look
from mechsearch.training.run_directory import load_policy, save_policy, trained
from mechsearch.types import ACTOR_KEYS, MechSearchError

SMALL = PushValueConfig(filters=4, hidden=(16, 8))


def make_policy(networks=2, candidates=12):
    torch.manual_seed(0)
    made = [PushValue(SMALL) for _ in range(networks)]
    return PushPolicy(made, Continuation(-5.0, 7.0), PushPolicyConfig(candidates))


@pytest.fixture
def env(covered, boxes):
    return HeapEnv([covered], boxes, HeapEnvConfig(privileged=True))


@pytest.fixture
def obs(env):
    return env.reset(seed=0, options={"heap": 0, "fixed_start": True})[0]


def test_the_best_push_is_the_one_that_the_networks_rate_highest_on_average(obs):
    policy = make_policy()
    sight, pushes = policy.see(obs), draw_pushes(20, np.random.default_rng(1))
    single = [
        PushPolicy([network], policy.continuation, policy.config).judge(pushes, sight)
        for network in policy.networks
    ]
    np.testing.assert_allclose(policy.judge(pushes, sight), np.mean(single, axis=0), atol=1e-5)
    assert policy.best(pushes, sight) == int(np.argmax(np.mean(single, axis=0)))


def test_a_push_is_carried_out_to_its_end_before_the_next_is_chosen(env, obs):
    policy, chosen = make_policy(), []
    best = policy.best
    policy.best = lambda pushes, sight: chosen.append(1) or best(pushes, sight)
    policy.reset(np.random.default_rng(0))
    actions = 0
    while len(chosen) < 3 and actions < 50:
        obs, _, terminated, truncated, _ = env.step(policy.act(obs))
        actions += 1
        if terminated or truncated:
            break
    assert actions >= 2 * (len(chosen) - 1)
    assert len(chosen) < actions


def test_a_saved_policy_is_the_same_policy(tmp_path, covered, boxes):
    policy, file = make_policy(), tmp_path / "actor.safetensors"
    save_policy(trained(policy, PushValues(), 123, TaskConfig()), file)
    loaded = load_policy(file)
    assert (loaded.training_actions, loaded.camera, loaded.image_size) == (123, "overhead", 64)
    read = loaded.policy
    assert (read.config, read.continuation) == (policy.config, policy.continuation)
    quiet = HeapEnv([covered], boxes)
    first, second = (run_episode(p, quiet, 0, seed=1) for p in (policy, read))
    np.testing.assert_array_equal(first.actions, second.actions)


def test_it_sees_what_the_actor_sees_and_nothing_else(env, obs):
    policy = make_policy()
    assert policy.keys == ACTOR_KEYS
    changed = {k: v if k in ACTOR_KEYS else np.full_like(v, 7) for k, v in obs.items()}
    actions = []
    for seen in (obs, changed):
        policy.reset(np.random.default_rng(3))
        actions.append(policy.act(seen))
    np.testing.assert_array_equal(*actions)


def test_a_target_that_is_hidden_is_looked_for_where_it_was_last(obs):
    policy = make_policy()
    hidden = {**obs, "position_image": np.zeros_like(obs["position_image"])}
    np.testing.assert_allclose(policy.see(hidden).centre[:2], 0.0)
    centre = policy.see(obs).centre
    np.testing.assert_array_equal(policy.see(hidden).centre, centre)
    policy.reset(np.random.default_rng(0))
    np.testing.assert_allclose(policy.see(hidden).centre[:2], 0.0)


def test_without_networks_pushes_are_random_and_the_generator_decides(obs):
    policy = make_policy(networks=0)
    acts = []
    for seed in (0, 0, 1):
        policy.reset(np.random.default_rng(seed))
        acts.append(policy.act(obs))
    np.testing.assert_array_equal(acts[0], acts[1])
    assert not np.array_equal(acts[0], acts[2])


def test_training_the_networks_later_does_not_change_a_policy(obs):
    network = PushValue(SMALL)
    policy = PushPolicy([network], Continuation(), PushPolicyConfig(12))
    sight, pushes = look(obs, policy.camera), draw_pushes(5, np.random.default_rng(0))
    before = policy.judge(pushes, sight)
    with torch.no_grad():
        for weight in network.parameters():
            weight.add_(1.0)
    np.testing.assert_array_equal(policy.judge(pushes, sight), before)


def test_damaged_foreign_and_missing_files_are_refused(tmp_path):
    file = tmp_path / "actor.safetensors"
    with pytest.raises(MechSearchError, match="no trained policy at"):
        load_policy(file)
    save_policy(trained(make_policy(), PushValues(), 123, TaskConfig()), file)
    data = bytearray(file.read_bytes())
    data[-5] ^= 1
    file.write_bytes(data)
    with pytest.raises(MechSearchError, match="damaged"):
        load_policy(file)
    file.write_bytes(b"something else")
    with pytest.raises(MechSearchError, match="damaged"):
        load_policy(file)


def test_a_file_says_by_which_algorithm_its_policy_was_learnt(tmp_path):
    file = tmp_path / "actor.safetensors"
    actor = Actor({"ee_position": (3,)}, NetworkConfig(hidden=(8, 8)))
    save_policy(trained(ActorPolicy(actor), ActorCritic(), 5, TaskConfig()), file)
    assert isinstance(load_policy(file).policy, ActorPolicy)
    save_archive(file, Archive("mechsearch checkpoint", {}, {}))
    with pytest.raises(MechSearchError, match="holds a mechsearch checkpoint; expected"):
        load_policy(file)


def test_no_candidates_are_refused():
    with pytest.raises(MechSearchError, match="candidates is 0"):
        replace(PushPolicyConfig(), candidates=0)
