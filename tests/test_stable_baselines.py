import importlib.util
from pathlib import Path

import numpy as np
import pytest

from mechsearch.actor_critic.algorithm import ActorCritic
from mechsearch.actor_critic.policy import ActorPolicy
from mechsearch.env.heap_env import TaskConfig
from mechsearch.training.run_directory import load_policy, save_policy, trained

EXAMPLE = Path(__file__).parents[1] / "examples" / "04_stable_baselines.py"


@pytest.fixture(scope="module")
def example():
    spec = importlib.util.spec_from_file_location("stable_baselines_example", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("algorithm", ["ddpg", "td3", "sac"])
def test_a_peers_actor_written_as_ours_acts_as_it_did_on_heaps(example, algorithm, tmp_path):
    model = example.model_of(example.Run(algorithm))
    policy = trained(ActorPolicy(example.actor_of(model)), ActorCritic(), 1, TaskConfig())
    save_policy(policy, tmp_path / "actor.safetensors")
    ours = load_policy(tmp_path / "actor.safetensors")
    env = model.get_env().envs[0].unwrapped
    env.action_space.seed(0)
    obs, _ = env.reset(seed=0)
    actions = []
    for _ in range(20):
        theirs, _ = model.predict(obs, deterministic=True)
        np.testing.assert_allclose(ours.act(obs), theirs, rtol=0, atol=1e-6)
        actions.append(theirs)
        obs, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            obs, _ = env.reset()
    assert np.ptp(actions, axis=0).max() > 1e-3
