import importlib.util
from pathlib import Path

import numpy as np
import pytest

from mechsearch.actor_critic.algorithm import ActorCritic
from mechsearch.actor_critic.policy import ActorPolicy
from mechsearch.env.heap_env import TaskConfig
from mechsearch.findings.experiment import read_run
from mechsearch.training.run_directory import load_policy, save_policy, trained
from mechsearch.training.stable_baselines import CurveCallback

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


def test_a_peer_is_scored_before_on_the_way_and_after_and_its_episodes_are_noted(example, tmp_path):
    model = example.model_of(example.Run("sac", actions=65))
    task = TaskConfig(max_actions=3)
    model.learn(65, callback=CurveCallback(tmp_path / "a", "peer", 30, limit=1, task=task))
    run = read_run(tmp_path / "a")
    steps, rewards = run.series("held_out", "reward")
    assert steps.tolist() == [0, 30, 60, 65]
    assert np.isfinite(rewards).all()
    model = example.model_of(example.Run("sac", actions=60))
    model.learn(60, callback=CurveCallback(tmp_path / "b", "peer", 30, limit=1, task=task))
    run = read_run(tmp_path / "b")
    assert run.series("held_out", "reward")[0].tolist() == [0, 30, 60]
    steps, lengths = run.series("episode", "length")
    assert len(steps)
    assert np.cumsum(lengths).tolist() == steps.tolist()
