"""A policy that looks, judges many pushes, carries out the best to its end, and looks again."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from mechsearch.camera import preset
from mechsearch.env import RewardConfig, TaskConfig
from mechsearch.push_values.value import Continuation, PushValue
from mechsearch.pushes.push import PlannedPush, Push, Sight, draw_pushes, look, view_pushes
from mechsearch.types import ACTOR_KEYS, Floats, MechSearchError, Observation

_UNSEEN = np.array([0.0, 0.0, 0.03])
"""Where a target is looked for that was never visible (3,) [m]: in the middle of the heap."""


@dataclass(frozen=True)
class PushPolicyConfig:
    """How pushes are chosen.

    Attributes:
        candidates: Random pushes to judge each time.
        camera: View of the images, a name for `camera.preset`.
        image_size: Side of the images [px].
        idleness: What an action costs.
    """

    candidates: int = 96
    camera: str = TaskConfig.camera
    image_size: int = TaskConfig.image_size
    idleness: float = RewardConfig.idleness

    def __post_init__(self) -> None:
        if self.candidates < 1:
            raise MechSearchError(f"candidates is {self.candidates}; expected at least 1")


class PushPolicy:
    """Chooses pushes by the mean judgement of some networks, from what the actor sees."""

    keys: tuple[str, ...] = ACTOR_KEYS

    def __init__(
        self,
        networks: Sequence[PushValue],
        continuation: Continuation,
        config: PushPolicyConfig,
    ) -> None:
        """Keep copies of the networks.

        Args:
            networks: Whose mean counts; without any, pushes are random.
            continuation: What is expected after a push.
            config: How pushes are chosen.
        """
        self.networks = [copy.deepcopy(network).eval() for network in networks]
        self.continuation, self.config = continuation, config
        self.camera = preset(config.camera, config.image_size)
        self.reset(np.random.default_rng(0))

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode; candidates come from `rng`."""
        self._rng = rng
        self._push: PlannedPush | None = None
        self._last_seen = _UNSEEN

    def act(self, obs: Observation) -> NDArray[np.float32]:
        """Return the next action (3,) of the present push, or of a new one."""
        action = None if self._push is None else self._push.act(obs)
        if action is None:
            sight = self.see(obs)
            pushes = draw_pushes(self.config.candidates, self._rng)
            self._push = PlannedPush(pushes[self.best(pushes, sight)], sight)
            action = self._push.act(obs)
        return np.zeros(3, np.float32) if action is None else action

    def see(self, obs: Observation) -> Sight:
        """Return what an observation shows; a hidden target counts as where it was seen last."""
        sight = look(obs, self.camera)
        if sight.centre is None:
            return replace(sight, centre=self._last_seen)
        self._last_seen = sight.centre
        return sight

    def best(self, pushes: Sequence[Push], sight: Sight) -> int:
        """Return the index of the best push."""
        return int(np.argmax(self.judge(pushes, sight)))

    def judge(self, pushes: Sequence[Push], sight: Sight) -> Floats:
        """Return the rewards expected of pushes and of what follows them (n,).

        Without networks all are alike, so that the first, a random one, is the best.
        """
        if not self.networks:
            return np.zeros(len(pushes))
        views = view_pushes(pushes, sight)
        patches, numbers = torch.from_numpy(views.patches), torch.from_numpy(views.numbers)
        planned = torch.from_numpy(views.actions)
        with torch.inference_mode():
            values = [
                n.value(patches, numbers, planned, self.continuation, self.config.idleness)
                for n in self.networks
            ]
            mean: Floats = torch.stack(values).mean(dim=0).double().numpy()
        return mean
