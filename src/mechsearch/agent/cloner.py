"""Imitation: an actor that learns the actions of an expert from its own observations."""

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from mechsearch.agent.networks import Actor, NetworkConfig, Shapes, Tensors
from mechsearch.agent.symmetry import SYMMETRIES, transform
from mechsearch.agent.weights import fill, fill_optimizer, optimizer_tensors, part, prefixed
from mechsearch.types import MechSearchError

LOSSES = ("mse", "l1", "huber", "direction")


@dataclass(frozen=True)
class ClonerConfig:
    """How the expert is imitated.

    Attributes:
        rate: Highest learning rate.
        weight_decay: Of AdamW.
        batch: Samples an update.
        loss: "mse", "l1" or "huber" between actions after the tanh, or "direction": one minus the
            cosine, plus half the squared difference of the lengths. Several pushes are often
            equally good, and the first three shrink towards their mean, which is to hesitate.
        symmetry: Turn and mirror every sample at random (overhead camera only).
        shift_px: Shift the images by up to so many pixels at random; 0 leaves them.
        average: Share of itself that the averaged actor keeps at each update.
    """

    rate: float = 1e-3
    weight_decay: float = 1e-2
    batch: int = 128
    loss: str = "direction"
    symmetry: bool = True
    shift_px: int = 0
    average: float = 0.998

    def __post_init__(self) -> None:
        if self.loss not in LOSSES:
            raise MechSearchError(f"unknown loss {self.loss!r}; choose one of {', '.join(LOSSES)}")
        if self.rate <= 0 or self.batch < 1 or self.shift_px < 0 or not 0 <= self.average < 1:
            raise MechSearchError(
                f"the cloner has rate {self.rate}, batch {self.batch}, shift_px {self.shift_px} "
                f"and average {self.average}; expected > 0, >= 1, >= 0 and [0, 1)"
            )


class Cloner:
    """An actor under imitation, and the running average of its weights, which is what acts."""

    def __init__(
        self, shapes: Shapes, network: NetworkConfig, config: ClonerConfig, seed: int
    ) -> None:
        """Build the actor; torch's own seed decides its first weights.

        Args:
            shapes: Shape of every observation that the actor reads.
            network: Its sizes.
            config: How it imitates.
            seed: Of the augmentation.
        """
        self.config = config
        self.actor = Actor(shapes, network)
        self.average = copy.deepcopy(self.actor).requires_grad_(False)
        self.optimizer = torch.optim.AdamW(
            self.actor.parameters(), config.rate, weight_decay=config.weight_decay, fused=True
        )
        self.generator = torch.Generator().manual_seed(seed)
        self.updates = 0

    def update(self, obs: Tensors, action: Tensor, rate: float = 1.0) -> dict[str, float]:
        """Take one step towards the expert's actions.

        Args:
            obs: Observations by key (B, *shape).
            action: The expert's actions (B, 3) in [-1, 1].
            rate: Share of the highest learning rate.
        """
        obs, action = self._augmented({**obs, "action": action})
        predicted = self.actor(obs)
        loss = self._loss(predicted, action)
        for group in self.optimizer.param_groups:
            group["lr"] = self.config.rate * rate
        self.optimizer.zero_grad()
        torch.autograd.backward(loss)
        self.optimizer.step()
        self._update_average()
        saturated = (predicted.detach().abs() > 0.99).float().mean()
        return {"loss": loss.item(), "saturated": saturated.item()}

    def _augmented(self, batch: Mapping[str, Tensor]) -> tuple[dict[str, Tensor], Tensor]:
        size = len(batch["action"])
        out = dict(batch)
        if self.config.symmetry:
            out = transform(out, self._draw(len(SYMMETRIES), size))
        if self.config.shift_px:
            shifts = self._draw(2 * self.config.shift_px + 1, 2) - self.config.shift_px
            out = {key: shifted(value, *shifts.tolist()) for key, value in out.items()}
        action = out.pop("action")
        return out, action

    def _draw(self, choices: int, count: int) -> Tensor:
        return torch.randint(choices, (count,), generator=self.generator)

    def _loss(self, predicted: Tensor, action: Tensor) -> Tensor:
        if self.config.loss == "mse":
            return functional.mse_loss(predicted, action)
        if self.config.loss == "l1":
            return functional.l1_loss(predicted, action)
        if self.config.loss == "direction":
            cosine = functional.cosine_similarity(predicted, action, eps=1e-3)
            lengths = predicted.norm(dim=1) - action.norm(dim=1)
            loss: Tensor = (1 - cosine + 0.5 * lengths.square()).mean()
            return loss
        return functional.huber_loss(predicted, action, delta=0.2)

    @torch.no_grad()
    def _update_average(self) -> None:
        self.updates += 1
        # Early on the average follows closely, else the first weights would linger.
        kept = min(self.config.average, self.updates / (self.updates + 10))
        torch._foreach_lerp_(
            list(self.average.parameters()), list(self.actor.parameters()), 1 - kept
        )

    @torch.no_grad()
    def error(self, obs: Tensors, action: Tensor) -> dict[str, float]:
        """Return how far the averaged actor is from the expert (B samples).

        `validation_loss` is the training loss; `angle_error` the mean angle between the two
        directions [rad].
        """
        predicted = self.average(obs)
        cosine = functional.cosine_similarity(predicted, action).clamp(-1, 1)
        return {
            "validation_loss": self._loss(predicted, action).item(),
            "angle_error": cosine.acos().mean().item(),
        }

    def state(self) -> dict[str, Tensor]:
        """Return all that a resume needs, by name."""
        return {
            **prefixed("actor", self.actor.state_dict()),
            **prefixed("average", self.average.state_dict()),
            **prefixed("optimizer", optimizer_tensors(self.optimizer)),
            "generator": self.generator.get_state(),
            "updates": torch.tensor([self.updates]),
        }

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Take back what `state` returned.

        Raises:
            MechSearchError: If it is of another network.
        """
        fill(self.actor, part(state, "actor"))
        fill(self.average, part(state, "average"))
        fill_optimizer(self.optimizer, part(state, "optimizer"))
        self.generator.set_state(state["generator"])
        self.updates = int(state["updates"])


def cosine_rate(progress: float, floor: float = 0.02) -> float:
    """Return the share of the highest learning rate at `progress` in [0, 1] of the schedule."""
    return floor + (1 - floor) * 0.5 * (1 + math.cos(math.pi * min(max(progress, 0.0), 1.0)))


def shifted(value: Tensor, rows: int, columns: int) -> Tensor:
    """Return images (B, C, H, W) moved by whole pixels, borders repeated; vectors as they are."""
    if value.ndim != 4:
        return value
    height, width = value.shape[-2:]
    row = torch.arange(height).sub(rows).clamp(0, height - 1)
    column = torch.arange(width).sub(columns).clamp(0, width - 1)
    return value[..., row, :][..., column]
