"""A policy that looks, judges many pushes, carries out the best to its end, and looks again."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from mechsearch.camera import preset
from mechsearch.env import RewardConfig, TaskConfig
from mechsearch.push_values.value import Continuation, Judgement, PushValue
from mechsearch.pushes.chooser import PushChooser
from mechsearch.pushes.push import NUMBERS, PATCH, Push, Sight, view_pushes
from mechsearch.types import Floats, MechSearchError


@dataclass(frozen=True)
class PushPolicyConfig:
    """How pushes are chosen.

    Attributes:
        candidates: Random pushes to judge each time.
        camera: View of the images, a name for `camera.preset`.
        image_size: Side of the images [px].
        idleness: What an action costs.
        searches: Whether a hidden target is looked for all over the heap; see `PushChooser`.
        full_steps: Whether pushes are carried out by actions of full length; see `Push`.
    """

    candidates: int = 96
    camera: str = TaskConfig.camera
    image_size: int = TaskConfig.image_size
    idleness: float = RewardConfig.idleness
    searches: bool = False
    full_steps: bool = False

    def __post_init__(self) -> None:
        if self.candidates < 1:
            raise MechSearchError(f"candidates is {self.candidates}; expected at least 1")


class PushPolicy(PushChooser):
    """Chooses pushes by the mean judgement of some networks, from what the actor sees."""

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
        view = preset(config.camera, config.image_size)
        super().__init__(view, config.candidates, config.searches, config.full_steps)

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

    def to_export(self) -> tuple[str, torch.nn.Module, tuple[torch.Tensor, ...]]:
        """Return what `training.export` writes: a kind, a network, and inputs to trace it with."""
        shapes = PATCH, (NUMBERS,), ()
        pushes = max(self.config.candidates, 2)
        inputs = [torch.zeros(pushes, *shape) for shape in shapes]
        judgement = Judgement(self.networks, self.continuation, self.config.idleness)
        return "pushes", judgement, (inputs[0].half(), *inputs[1:])
