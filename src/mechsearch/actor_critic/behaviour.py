"""Who acts while actor and critic learn: copies of them that stay as they are."""

import copy
from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mechsearch.actor_critic.learner import Learner
from mechsearch.files.tensors import fill, part, prefixed
from mechsearch.types import Floats, Observation, select


class Behaviour:
    """Copies of a learner's actor and critic; they may be asked in another thread than it learns.

    `refresh` brings them up to date, when nobody is asking.
    """

    def __init__(self, learner: Learner, seed: int) -> None:
        """Copy a learner's networks.

        Args:
            learner: Whose.
            seed: Of the dropout masks.
        """
        self._learner = learner
        self.actor = copy.deepcopy(learner.actor).requires_grad_(False).eval()
        self.critic = copy.deepcopy(learner.critic).requires_grad_(False).eval()
        self.generator = torch.Generator().manual_seed(seed)

    @torch.no_grad()
    def refresh(self) -> None:
        """Take over what was learnt."""
        for own, learnt in (
            (self.actor, self._learner.actor),
            (self.critic, self._learner.critic),
        ):
            torch._foreach_copy_(list(own.parameters()), list(learnt.parameters()))

    def state(self) -> dict[str, Tensor]:
        """Return the copies and the source of the masks, by name."""
        actor, critic = self.actor.state_dict(), self.critic.state_dict()
        networks = {**prefixed("actor", actor), **prefixed("critic", critic)}
        return {"generator": self.generator.get_state(), **networks}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Take back what `state` returned.

        Raises:
            MechSearchError: If it is of other networks.
        """
        self.generator.set_state(state["generator"])
        fill(self.actor, part(state, "actor"))
        fill(self.critic, part(state, "critic"))

    @torch.no_grad()
    def act(self, obs: Observation) -> NDArray[np.float32]:
        """Return the actor's action (3,) for one observation, without noise."""
        action: NDArray[np.float32] = self.actor(_single(obs, self.actor.keys))[0].numpy()
        return action

    @torch.no_grad()
    def q_samples(self, obs: Observation, actions: NDArray[np.float32]) -> Floats:
        """Return samples (S, M) of the Q of M actions (M, 3) in one observation.

        One row is one draw of the critic that scores all actions, in units of the reward.
        """
        config, count = self._learner.config, len(actions)
        features = self.critic.encode(_single(obs, tuple(self.critic.shapes)))
        masks = self.critic.draw_masks(config.samples, 1, self.generator) if config.dropout else []
        q = self.critic.value(features.expand(count, -1), torch.as_tensor(actions), masks)
        samples: Floats = q.reshape(-1, count).double().numpy() / config.reward_scale
        return samples


def _single(obs: Observation, keys: tuple[str, ...]) -> Mapping[str, Tensor]:
    return {key: torch.as_tensor(value)[None] for key, value in select(obs, keys).items()}
