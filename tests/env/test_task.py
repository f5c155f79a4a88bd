"""The task as a record, what it refuses and how two differ, and rewards of one's own."""

import json
import sys
from dataclasses import asdict, replace

import numpy as np
import pytest

import mechsearch
from mechsearch.env.heap_env import (
    HeapEnv,
    HeapEnvConfig,
    TaskConfig,
    task_from_json,
)
from mechsearch.env.reward import RewardConfig
from mechsearch.evaluation.rollout import differing
from mechsearch.sim.scene import PhysicsConfig, Pusher, Workspace
from mechsearch.types import ACTOR_KEYS, MechSearchError

FIXED = {"heap": 0, "fixed_start": True}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"max_actions": 0}, "max_actions is 0; expected at least 1"),
        ({"image_size": 4}, "image size 4 px is too small; expected at least 8"),
        ({"camera": "sideways"}, "unknown camera 'sideways'; choose one of overhead, tilted"),
        ({"uncovered_at": 1.0}, "uncovered_at is 1.0; expected less than 1"),
        ({"uncovered_at": -0.1}, "uncovered_at is -0.1; expected at least 0"),
        ({"start_distance": float("nan")}, "start_distance is nan; expected at least 0"),
        ({"physics": PhysicsConfig(time_step=0.0)}, "physics.time_step is 0.0; expected more"),
        ({"physics": PhysicsConfig(contact_time=0.009)}, "physics.contact_time is 0.009"),
        ({"physics": PhysicsConfig(contact_impedance=(0.9, 1.5))}, "contact_impedance is"),
        ({"workspace": Workspace(high=0.0)}, "workspace.high is 0.0; expected more than 0.01"),
        ({"pusher": Pusher(mass=-1.0)}, "pusher.mass is -1.0; expected more than 0"),
        ({"pusher": Pusher(length=0.01)}, "pusher.length is 0.01; expected more than 0.024"),
        ({"pusher": Pusher(force=float("inf"))}, "pusher.force is inf"),
    ],
)
def test_a_task_that_cannot_be_is_refused_by_field_and_value(settings, message):
    with pytest.raises(MechSearchError, match=message):
        TaskConfig(**settings)
    with pytest.raises(MechSearchError, match=message):
        HeapEnvConfig(**settings)


def test_infinite_limits_mean_no_limit():
    assert TaskConfig(physics=PhysicsConfig(clearance=np.inf, explosion_speed=np.inf))


def test_an_environment_shows_some_keys_of_a_task():
    task = TaskConfig(max_actions=7, reward=RewardConfig(movement=10.0))
    config = HeapEnvConfig.of_task(task, ["ee_position"], privileged=True)
    assert (config.keys, config.privileged) == (("ee_position",), True)
    assert differing(task, config) == ()


def test_what_differs_is_named_with_both_values():
    other = TaskConfig(camera="tilted", reward=RewardConfig(movement=100.0, idleness=0.25))
    assert differing(TaskConfig(), other) == (
        "camera overhead -> tilted",
        "reward.movement 75 -> 100",
        "reward.idleness 0.5 -> 0.25",
    )


@pytest.mark.parametrize("config", [TaskConfig(max_actions=9), HeapEnvConfig(privileged=True)])
def test_a_task_is_read_back_and_one_of_an_earlier_version_too(config):
    written = json.loads(json.dumps(asdict(config)))
    assert task_from_json(type(config), written) == config
    written["reward"]["least_occlusion"] = 0.02
    assert task_from_json(type(config), written) == config
    written["reward"]["least_occlusion"] = 0.05
    with pytest.raises(MechSearchError, match=r"least_occlusion is 0.05, and uncovered_at 0.02"):
        task_from_json(type(config), written)


def test_what_no_version_wrote_is_refused():
    with pytest.raises(MechSearchError, match="TaskConfig has no colour; it has camera"):
        task_from_json(TaskConfig, {"colour": 3})
    with pytest.raises(MechSearchError, match="RewardConfig is 3"):
        task_from_json(TaskConfig, {"reward": 3})


@pytest.fixture
def own_rewards(tmp_path, monkeypatch):
    """The name of a module of rewards."""
    (tmp_path / "own_rewards.py").write_text(
        "def sparse(before, after, clutter, target, leaves, uncovered_at, config):\n"
        "    return {'success': float(after <= uncovered_at), 'clutter': -clutter.mean()}\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    yield "own_rewards"
    sys.modules.pop("own_rewards", None)


def test_a_reward_of_ones_own_names_its_terms_and_their_sum_is_the_reward(own_rewards):
    reward = RewardConfig(function=f"{own_rewards}:sparse")
    env = mechsearch.make_env(reward=reward, max_actions=3)
    env.reset(options=FIXED)
    for _ in range(3):
        _, total, _, _, info = env.step(np.zeros(3, np.float32))
        assert list(info["reward_terms"]) == ["success", "clutter"]
        assert total == sum(info["reward_terms"].values())
    assert info["end"] == "action limit"


def test_a_failed_simulation_gives_none_of_ones_own_terms(own_rewards, covered, boxes, monkeypatch):
    monkeypatch.setattr("mechsearch.sim.world.World.failure", lambda world: "NaN")
    config = HeapEnvConfig(
        reward=RewardConfig(function=f"{own_rewards}:sparse"),
        physics=PhysicsConfig(clearance=np.inf),
    )
    env = HeapEnv([covered], boxes, config)
    env.reset(options=FIXED)
    _, total, _, truncated, info = env.step(np.ones(3, np.float32))
    assert truncated
    assert (total, info["reward_terms"]) == (0.0, {"success": 0.0, "clutter": 0.0})


def test_there_is_no_heap_or_state_before_an_episode(covered, boxes):
    env = HeapEnv([covered], boxes)
    for name in ("heap", "state", "world"):
        with pytest.raises(MechSearchError, match="call reset first"):
            getattr(env, name)


def test_settings_of_the_task_are_settings_of_an_environment():
    env = mechsearch.make_env(max_actions=30, reward=RewardConfig(movement=1.0))
    assert env.config == replace(
        HeapEnvConfig(max_actions=30, reward=RewardConfig(movement=1.0)), keys=ACTOR_KEYS
    )
