"""A small world: move the effector to the target. No physics, the same observations."""

import gymnasium
import numpy as np
import pytest

from mechsearch.actor_critic.algorithm import ActorCritic
from mechsearch.actor_critic.learner import LearnerConfig
from mechsearch.actor_critic.networks import NetworkConfig
from mechsearch.algorithm import RunConfig, TrainingSetup
from mechsearch.types import TEACHER_KEYS

SIZE = 16
BOX = gymnasium.spaces.Box
SMALL = NetworkConfig(filters=4, hidden=(32, 32))


class ReachEnv(gymnasium.Env):
    """Heap i is a target at a place of its own; a failure may be ordered at a count of steps."""

    action_space = BOX(-1.0, 1.0, (3,), np.float32)
    observation_space = gymnasium.spaces.Dict(
        {
            "depth": BOX(0, 2, (1, SIZE, SIZE), np.float16),
            "position_image": BOX(-2, 2, (3, SIZE, SIZE), np.float16),
            "ee_position": BOX(-1, 1, (3,), np.float32),
            "target_offset": BOX(-1, 1, (3,), np.float32),
            "clutter_offsets": BOX(-1, 1, (2, 3), np.float32),
            "clutter_mask": gymnasium.spaces.MultiBinary(2),
        }
    )

    def __init__(self, fail_at=-1, limit=10):
        self.fail_at, self.limit, self.total = fail_at, limit, 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        place = np.random.default_rng(options["heap"])
        self.target = place.uniform(-0.1, 0.1, 3) * [1, 1, 0]
        self.ee = self.np_random.uniform(-0.2, 0.2, 3) * [1, 1, 0]
        self.actions = 0
        return self.observe(), {}

    def step(self, action):
        assert np.abs(action).max() <= 1
        self.actions += 1
        self.total += 1
        self.ee = np.clip(self.ee + 0.05 * np.asarray(action) * [1, 1, 0], -0.3, 0.3)
        distance = float(np.linalg.norm(self.target - self.ee))
        failure = "explosion" if self.total == self.fail_at else None
        terminated = distance < 0.05 and not failure
        truncated = not terminated and (self.actions == self.limit or failure is not None)
        info = {
            "reward_terms": {"near": -10 * distance, "idle": -0.5},
            "failure": failure,
            "occlusion": min(1.0, distance),
            "end": "uncovered" if terminated else "action limit" if truncated else None,
        }
        return self.observe(), -10 * distance - 0.5, terminated, truncated, info

    def snapshot(self):
        return {name: np.array(getattr(self, name)) for name in ("target", "ee", "actions")}

    def restore(self, snapshot):
        self.target, self.ee = snapshot["target"].copy(), snapshot["ee"].copy()
        self.actions = int(snapshot["actions"])
        return self.observe()

    def observe(self):
        offset = (self.target - self.ee).astype(np.float32)
        image = np.zeros((3, SIZE, SIZE), np.float16)
        image[:, 4:12, 4:12] = offset[:, None, None]
        return {
            "depth": np.ones((1, SIZE, SIZE), np.float16),
            "position_image": image,
            "ee_position": self.ee.astype(np.float32),
            "target_offset": offset,
            "clutter_offsets": np.zeros((2, 3), np.float32),
            "clutter_mask": np.zeros(2, np.int8),
        }


class Pointer:
    """A teacher that goes straight to the target, or straight away from it."""

    keys = TEACHER_KEYS

    def __init__(self, sign=1.0):
        self.sign = sign

    def reset(self, rng):
        self.rng = rng

    def state(self):
        return {"rng": self.rng.bit_generator.state}

    def restore(self, state):
        self.rng = np.random.default_rng()
        self.rng.bit_generator.state = state["rng"]

    def act(self, obs):
        assert set(obs) == set(self.keys)
        noise = self.rng.normal(0, 0.05, 3)
        return np.clip(self.sign * obs["target_offset"] / 0.05 + noise, -1, 1).astype(np.float32)


def distance_left(policy, episodes=8):
    """Score a policy: mean return and share of targets reached, from fixed starts."""
    env, returns, reached = ReachEnv(), [], []
    for i in range(episodes):
        obs, _ = env.reset(seed=i, options={"heap": i})
        policy.reset(np.random.default_rng(i))
        over, total, terminated = False, 0.0, False
        while not over:
            seen = {key: obs[key] for key in policy.keys}
            obs, reward, terminated, truncated, _ = env.step(policy.act(seen))
            over, total = terminated or truncated, total + reward
        returns.append(total)
        reached.append(terminated)
    return {"reward": float(np.mean(returns)), "uncovered_rate": float(np.mean(reached))}


@pytest.fixture(scope="session")
def reach_env():
    return ReachEnv


@pytest.fixture(scope="session")
def pointer():
    return Pointer


@pytest.fixture(scope="session")
def make_parts():
    def make(env=None, teachers=True):
        guides = {"straight": Pointer(), "zigzag": Pointer(-1.0)} if teachers else {}
        return TrainingSetup(env or ReachEnv(), range(8), guides, {"validation": distance_left})

    return make


@pytest.fixture(scope="session")
def config():
    learner = LearnerConfig(batch=16, samples=5, network=SMALL, actor_rate=1e-3, actor_tau=0.05)
    return RunConfig("method", ActorCritic()).changed(
        actions=120,
        teachers=("straight", "zigzag"),
        warmup=20,
        updates_per_action=0.5,
        evaluate_every=50,
        checkpoint_every=40,
        learner=learner,
    )


@pytest.fixture(scope="session")
def score():
    return distance_left
