"""Train an algorithm of stable-baselines3 on heaps, and write its actor as one of our own.

    python examples/04_stable_baselines.py --algorithm td3 --actions 8000 --out runs/sb3-td3

Its actor is a file like any other (`mechsearch evaluate runs/sb3-td3 --heaps ...`): towers, two
dense layers and a tanh are the same function there and here. `mechsearch report runs/sb3-td3` draws
its curve on held-out heaps.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import gymnasium
import numpy as np
import torch
import tyro
from stable_baselines3 import DDPG, SAC, TD3
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from mechsearch.actor_critic.algorithm import ActorCritic
from mechsearch.actor_critic.networks import Actor, Encoder, NetworkConfig
from mechsearch.actor_critic.policy import ActorPolicy
from mechsearch.env.heap_env import TaskConfig
from mechsearch.files import POLICY_FILE
from mechsearch.training.run_directory import save_policy, trained
from mechsearch.training.stable_baselines import CurveCallback

ALGORITHMS = {"ddpg": DDPG, "td3": TD3, "sac": SAC}


@dataclass(frozen=True)
class Run:
    """What is trained on what; everything not said here is the algorithm's own default.

    Attributes:
        algorithm: Of stable-baselines3.
        actions: Actions executed, with one update for each after the first hundred.
        seed: Of everything random.
        heaps: Heap set (.parquet), whose training heaps are learnt on; the embedded ones if empty.
        objects: Object set that the heaps were made with.
        gamma: Discount, the same as our learner's.
        batch: Transitions in each update, likewise.
        noise: Standard deviation of the Gaussian exploration of DDPG and TD3.
        evaluate_every: Actions between evaluations.
        held_out_heaps: Of them, on how many; 0 takes all.
        out: Run directory to write.
    """

    algorithm: Literal["ddpg", "td3", "sac"] = "ddpg"
    actions: int = 110
    seed: int = 0
    heaps: str = ""
    objects: str = "household"
    gamma: float = 0.9
    batch: int = 64
    noise: float = 0.2
    evaluate_every: int = 1000
    held_out_heaps: int = 2
    out: Path = Path("sb3")


class Towers(BaseFeaturesExtractor):
    """Our two towers as the features of stable-baselines3."""

    def __init__(self, observation_space):
        shapes = {key: space.shape for key, space in observation_space.items()}
        encoder = Encoder(shapes, NetworkConfig())
        super().__init__(observation_space, encoder.width)
        self.encoder = encoder

    def forward(self, observations):
        """Return features (B, width)."""
        return self.encoder(observations)


def model_of(run):
    """Return the algorithm, untrained, on the registered environment as it is."""
    env = gymnasium.make(
        "mechsearch/SingleHeap-v0", heaps=run.heaps or None, objects=run.objects, split="train"
    )
    explores = {"action_noise": NormalActionNoise(np.zeros(3), np.full(3, run.noise))}
    return ALGORITHMS[run.algorithm](
        "MultiInputPolicy",
        env,
        buffer_size=max(run.actions, 2),
        batch_size=run.batch,
        gamma=run.gamma,
        seed=run.seed,
        device="cpu",
        policy_kwargs={"features_extractor_class": Towers},
        **({} if run.algorithm == "sac" else explores),
    )


def actor_of(model):
    """Return the model's deterministic actor, layer by layer, as one of our own."""
    theirs = model.policy.actor
    layers = [*theirs.latent_pi, theirs.mu] if isinstance(model, SAC) else [*theirs.mu]
    *hidden, output = (layer for layer in layers if isinstance(layer, torch.nn.Linear))
    widths = tuple(layer.out_features for layer in hidden)
    shapes = {key: space.shape for key, space in model.observation_space.items()}
    actor = Actor(shapes, replace(NetworkConfig(), hidden=widths, layer_norm=False))
    actor.encoder.load_state_dict(theirs.features_extractor.encoder.state_dict())
    for own, layer in zip([*actor.trunk.layers, actor.output], [*hidden, output], strict=True):
        own.load_state_dict(layer.state_dict())
    return actor


def main(run):
    """Train, and write the actor beside what it came from."""
    torch.set_num_threads(1)
    model, name = model_of(run), f"sb3-{run.algorithm}"
    curve = CurveCallback(
        run.out, name, run.evaluate_every, seed=run.seed, heaps=run.heaps or None,
        objects=run.objects, limit=run.held_out_heaps,
    )  # fmt: skip
    model.learn(run.actions, callback=curve)
    rewards = [episode["r"] for episode in model.ep_info_buffer]
    policy = trained(ActorPolicy(actor_of(model)), ActorCritic(), model.num_timesteps, TaskConfig())
    save_policy(policy, run.out / POLICY_FILE)
    print(f"{name}: {model.num_timesteps} actions, last episodes' mean reward", end=" ")
    print(f"{np.mean(rewards):.1f}; the actor is in {run.out}")


if __name__ == "__main__":
    main(tyro.cli(Run))
