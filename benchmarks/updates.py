"""`updates-ddpg`, `updates-method`: learner updates a second, beside stable-baselines3."""

import time
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3 import DDPG
from stable_baselines3.common.logger import configure
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from benchmarks.results import Figure
from benchmarks.settings import Settings
from mechsearch.actor_critic.learner import Learner
from mechsearch.actor_critic.networks import Encoder, NetworkConfig
from mechsearch.actor_critic.replay import Replay
from mechsearch.env.heap_env import HeapEnv, HeapEnvConfig
from mechsearch.training.config import TrainConfig, preset_config
from mechsearch.types import ACTOR_KEYS, Array

PEER = "DDPG of stable-baselines3 2.9, same towers, batch and keys"
_FRAMES = 500

Transition = tuple[dict[str, Array], Array, float, dict[str, Array], bool]


class Towers(BaseFeaturesExtractor):
    """Our towers as the peer's feature extractor."""

    def __init__(self, observation_space: gymnasium.spaces.Dict) -> None:
        shapes = {key: tuple(space.shape or ()) for key, space in observation_space.items()}
        encoder = Encoder(shapes, NetworkConfig())
        super().__init__(observation_space, encoder.width)
        self.encoder = encoder

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return features (B, width)."""
        features: torch.Tensor = self.encoder(observations)
        return features


def measure(settings: Settings) -> Iterator[Figure]:
    """Time updates from the same transitions, in turns, on one thread."""
    torch.set_num_threads(1)
    workload = settings.workload
    config = HeapEnvConfig(privileged=True, camera=workload.heap_set.camera)
    env = HeapEnv(workload.heaps(15, 4), workload.object_set, config)
    transitions = _transitions(env)
    contenders = {
        "ddpg": _ours(preset_config("ddpg"), env, transitions),
        "method": _ours(preset_config("method"), env, transitions),
        "peer": _peer(env, transitions),
    }
    rounds: dict[str, list[float]] = {name: [] for name in contenders}
    for turn in range(6 if settings.full else 4):
        for name, update in contenders.items():
            began = time.perf_counter()
            update(25)
            if turn:
                rounds[name].append(25 / (time.perf_counter() - began))
        settings.say(f"updates: round {turn + 1}")
    rates = {name: float(np.median(values)) for name, values in rounds.items()}
    yield Figure("updates-ddpg", rates["ddpg"], "updates/s", PEER, rates["peer"], "more")
    note = "the peer has no privileged critic and no dropout copies"
    yield Figure("updates-method", rates["method"], "updates/s", PEER, rates["peer"], "more", note)


def _transitions(env: HeapEnv) -> list[Transition]:
    """Return what random actions led to."""
    env.action_space.seed(0)
    obs, _ = env.reset(seed=0)
    rows: list[Transition] = []
    while len(rows) < _FRAMES:
        action = env.action_space.sample()
        after, reward, terminated, truncated, _ = env.step(action)
        rows.append((obs, action, reward, after, terminated))
        obs = env.reset()[0] if terminated or truncated else after
    return rows


def _ours(config: TrainConfig, env: HeapEnv, rows: list[Transition]) -> Callable[[int], None]:
    """Return our learner's updates."""
    torch.manual_seed(0)
    spaces: Any = env.observation_space
    shapes = {key: tuple(space.shape) for key, space in spaces.items()}
    dtypes = {key: np.dtype(space.dtype) for key, space in spaces.items()}
    actor = {key: shapes[key] for key in config.actor_keys}
    critic = {key: shapes[key] for key in config.critic_keys}
    learner = Learner(actor, critic, config.learner, 0)
    kept = {key: shapes[key] for key in {**actor, **critic}}
    replay = Replay(kept, {key: dtypes[key] for key in kept}, 2 * _FRAMES + 2)
    for obs, action, reward, after, terminated in rows:
        replay.add(obs, action, reward, 0.0 if terminated else config.learner.gamma)
        replay.end(after)
    rng = np.random.default_rng(0)

    def update(number: int) -> None:
        for _ in range(number):
            learner.update(replay, rng)

    return update


def _peer(env: HeapEnv, rows: list[Transition]) -> Callable[[int], None]:
    """Return the peer's updates, from its own replay."""
    seen = _ActorView(env)
    settings = preset_config("ddpg").learner
    model = DDPG(
        "MultiInputPolicy",
        seen,
        buffer_size=2 * _FRAMES,
        batch_size=settings.batch,
        policy_kwargs={
            "features_extractor_class": Towers,
            "net_arch": list(NetworkConfig().hidden),
        },
        device="cpu",
    )
    model.set_logger(configure(None, []))
    buffer: Any = model.replay_buffer
    for obs, action, reward, after, terminated in rows:
        buffer.add(
            seen.observation(obs), seen.observation(after), action[None],
            np.array([reward]), np.array([terminated]), [{}],
        )  # fmt: skip

    def update(number: int) -> None:
        model.train(gradient_steps=number, batch_size=settings.batch)

    return update


class _ActorView(gymnasium.ObservationWrapper[Any, Any, Any]):
    """The actor's keys alone, in float32: the peer keeps no half precision."""

    def __init__(self, env: HeapEnv) -> None:
        super().__init__(env)
        spaces: Any = env.observation_space
        self.observation_space = gymnasium.spaces.Dict(
            {
                key: gymnasium.spaces.Box(-10.0, 10.0, spaces[key].shape, np.float32)
                for key in ACTOR_KEYS
            }
        )

    def observation(self, observation: dict[str, Array]) -> dict[str, Array]:
        """Return the actor's part of an observation."""
        return {key: observation[key].astype(np.float32) for key in ACTOR_KEYS}
