"""A trained actor as a policy: arrays in, arrays out."""

import copy

import numpy as np
import torch
from numpy.typing import NDArray

from mechsearch.actor_critic.networks import Actor
from mechsearch.observe.observation import KINDS
from mechsearch.types import MechSearchError, Observation, select


class ActorPolicy:
    """An actor without noise; the same observation gives the same action."""

    def __init__(self, actor: Actor) -> None:
        """Keep a copy: training the original later does not change this policy."""
        self.actor = copy.deepcopy(actor).eval()
        self.keys = actor.keys

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

    def to_export(self) -> tuple[str, torch.nn.Module, tuple[torch.Tensor, ...]]:
        """Return what `training.export` writes: a kind, a network, and inputs to trace it with."""
        inputs = [
            torch.zeros(
                1,
                *self.actor.shapes[key],
                dtype=torch.from_numpy(np.empty(0, KINDS[key].dtype)).dtype,
            )
            for key in self.keys
        ]
        return "actions", _OfArguments(self.actor), tuple(inputs)


class _OfArguments(torch.nn.Module):
    """An actor whose observation comes key by key."""

    def __init__(self, actor: Actor) -> None:
        super().__init__()
        self.actor = actor

    def forward(self, *values: torch.Tensor) -> torch.Tensor:
        """Return actions (B, 3)."""
        actions: torch.Tensor = self.actor(dict(zip(self.actor.keys, values, strict=True)))
        return actions
