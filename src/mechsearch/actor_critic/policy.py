"""A trained actor as a policy: arrays in, arrays out."""

import copy
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from mechsearch.actor_critic.networks import Actor, NetworkConfig
from mechsearch.files import record_from_json
from mechsearch.files.layout import POLICY_FILE
from mechsearch.files.tensors import Archive, load_archive, save_archive
from mechsearch.types import MechSearchError, Observation, select

KIND = "mechsearch actor"


class ActorPolicy:
    """An actor without noise; the same observation gives the same action."""

    def __init__(self, actor: Actor, training_actions: int = 0) -> None:
        """Keep a copy: training the original later does not change this policy.

        Args:
            actor: What acts.
            training_actions: Actions executed in its training, for the record.
        """
        self.actor = copy.deepcopy(actor).eval()
        self.keys = actor.keys
        self.training_actions = training_actions

    def reset(self, rng: np.random.Generator) -> None:
        """Do nothing: the actor remembers nothing."""

    def act(self, obs: Observation) -> NDArray[np.float32]:
        """Return the action (3,) in [-1, 1] for one observation.

        Raises:
            MechSearchError: If a key is missing or has another shape than in training.
        """
        tensors = {}
        for key, value in select(obs, self.keys).items():
            if value.shape != self.actor.shapes[key]:
                raise MechSearchError(
                    f"observation {key!r} is {value.shape}; this actor was trained on "
                    f"{self.actor.shapes[key]}"
                )
            tensors[key] = torch.as_tensor(value)[None]
        with torch.inference_mode():
            result: NDArray[np.float32] = self.actor(tensors)[0].numpy()
        return result


def save_actor(policy: ActorPolicy, path: Path) -> None:
    """Write an actor to a safetensors file that `load_actor` needs nothing beside."""
    actor = policy.actor
    meta = {
        # Pairs, since the order of the keys is the order of the heads' features.
        "shapes": [[key, list(shape)] for key, shape in actor.shapes.items()],
        "network": asdict(actor.config),
        "training_actions": policy.training_actions,
    }
    save_archive(path, Archive(KIND, dict(actor.state_dict()), meta))


def load_actor(path: Path) -> ActorPolicy:
    """Read an actor written by `save_actor`.

    Args:
        path: The file, or a run directory, whose last actor is meant.

    Raises:
        MechSearchError: If the file is missing, damaged or holds something else.
    """
    archive = load_archive(path / POLICY_FILE if path.is_dir() else path, KIND)
    network = record_from_json(NetworkConfig, archive.meta["network"])
    shapes = {key: tuple(shape) for key, shape in archive.meta["shapes"]}
    actor = Actor(shapes, network)
    archive.fill(actor)
    return ActorPolicy(actor, int(archive.meta["training_actions"]))
