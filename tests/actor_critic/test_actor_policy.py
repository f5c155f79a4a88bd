import numpy as np
import pytest
import torch

from mechsearch.actor_critic.algorithm import ActorCritic
from mechsearch.actor_critic.networks import Actor, NetworkConfig
from mechsearch.actor_critic.policy import ActorPolicy
from mechsearch.env.heap_env import TaskConfig
from mechsearch.training.run_directory import load_policy, save_policy, trained
from mechsearch.types import ACTOR_KEYS, MechSearchError, Policy

SHAPES = {"depth": (1, 16, 16), "position_image": (3, 16, 16), "ee_position": (3,)}


@pytest.fixture
def actor():
    torch.manual_seed(0)
    return Actor(SHAPES, NetworkConfig(hidden=(32, 32)))


@pytest.fixture
def obs():
    rng = np.random.default_rng(0)
    kinds = {"ee_position": np.float32}
    return {k: rng.random(s).astype(kinds.get(k, np.float16)) for k, s in SHAPES.items()}


def test_an_actor_is_a_policy_that_reads_the_actors_keys(actor, obs):
    policy = ActorPolicy(actor)
    assert isinstance(policy, Policy)
    assert set(policy.keys) == set(ACTOR_KEYS)
    action = policy.act(obs)
    assert action.shape == (3,)
    assert action.dtype == np.float32
    np.testing.assert_array_equal(action, policy.act(obs))


def test_training_goes_on_without_changing_a_policy(actor, obs):
    policy = ActorPolicy(actor)
    before = policy.act(obs)
    torch.nn.init.ones_(actor.output.weight)
    np.testing.assert_array_equal(policy.act(obs), before)


def test_a_saved_actor_acts_as_before(actor, obs, tmp_path):
    save_policy(
        trained(ActorPolicy(actor), ActorCritic(), 8000, TaskConfig()),
        tmp_path / "actor.safetensors",
    )
    for path in (tmp_path / "actor.safetensors", tmp_path):
        loaded = load_policy(path)
        np.testing.assert_array_equal(loaded.act(obs), ActorPolicy(actor).act(obs))
        assert loaded.training_actions == 8000
        assert loaded.policy.actor.config == actor.config


def test_an_observation_of_another_shape_is_refused(actor, obs):
    policy = ActorPolicy(actor)
    with pytest.raises(MechSearchError, match=r"\(1, 8, 8\).*\(1, 16, 16\)"):
        policy.act({**obs, "depth": np.zeros((1, 8, 8), np.float16)})
    with pytest.raises(MechSearchError, match="lacks depth"):
        policy.act({"ee_position": obs["ee_position"]})


def test_every_flipped_bit_is_found(actor, tmp_path):
    path = tmp_path / "actor.safetensors"
    save_policy(trained(ActorPolicy(actor), ActorCritic(), 1, TaskConfig()), path)
    whole = path.read_bytes()
    for place in np.linspace(0, len(whole) - 1, 40).astype(int):
        damaged = bytearray(whole)
        damaged[place] ^= 1
        path.write_bytes(bytes(damaged))
        with pytest.raises(MechSearchError, match=r"damaged|holds"):
            load_policy(path)


def test_a_torn_file_and_a_missing_one_are_refused(actor, tmp_path):
    path = tmp_path / "actor.safetensors"
    with pytest.raises(MechSearchError, match="no trained policy"):
        load_policy(path)
    save_policy(trained(ActorPolicy(actor), ActorCritic(), 1, TaskConfig()), path)
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(MechSearchError, match="damaged"):
        load_policy(path)
    path.write_text("hello")
    with pytest.raises(MechSearchError, match="damaged"):
        load_policy(path)
