"""What a push will bring, judged from how it looks: a small network, and its fit to outcomes."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from mechsearch.pushes.push import MIRRORED_NUMBERS, NUMBERS, PATCH, STRAIGHT_NUMBER, PushViews
from mechsearch.types import MechSearchError

_REWARD, _ACTIONS = 5.0, 5.0
"""What the network's numbers are multiplied by: rewards, and actions beyond the planned."""

_HIGHEST, _LOWEST = 12.0, -25.0
"""Rewards of a push beyond these teach nothing more."""


@dataclass(frozen=True)
class PushValueConfig:
    """The network, its fit, and what counts as a good push.

    Attributes:
        filters: Channels of the first convolution; the next two have twice as many.
        hidden: Widths of the dense layers.
        dropout: Share of units dropped while fitting.
        rate: Highest learning rate.
        weight_decay: Of AdamW.
        batch: Pushes an update.
        epochs: How often a fit sees every push.
        gentleness: Cost of each metre that the mean non-target object moves, beyond the reward.
    """

    filters: int = 32
    hidden: tuple[int, int] = (256, 128)
    dropout: float = 0.3
    rate: float = 1.5e-3
    weight_decay: float = 1e-2
    batch: int = 128
    epochs: float = 15.0
    gentleness: float = 30.0

    def __post_init__(self) -> None:
        if not 0 <= self.dropout < 1:
            raise MechSearchError(f"dropout is {self.dropout}; expected a share in [0, 1)")
        for name in ("filters", "rate", "batch", "epochs"):
            if getattr(self, name) <= 0:
                raise MechSearchError(f"{name} is {getattr(self, name)}; expected more than 0")


@dataclass(frozen=True)
class PushOutcome:
    """What a push brought.

    Attributes:
        reward: Sum of all reward terms but idleness.
        actions: How many it took.
        uncovered: Whether it ended the episode with the target uncovered.
        occlusion: Of the target afterwards; 1 where it was lost.
        clutter_moved: Sum over the actions of the mean non-target displacement [m].
    """

    reward: float
    actions: int
    uncovered: bool
    occlusion: float
    clutter_moved: float


@dataclass(frozen=True)
class Continuation:
    """What follows a push that did not uncover the target: `at_once - by_occlusion * occlusion`."""

    at_once: float = -6.0
    by_occlusion: float = 6.0

    def value(self, occlusion: Tensor) -> Tensor:
        """Return the rewards still to come (B,) after pushes that left occlusions (B,)."""
        return self.at_once - self.by_occlusion * occlusion.clamp(0, 1)


@dataclass(frozen=True)
class PushSamples:
    """Pushes and what they brought, as tensors.

    Attributes:
        patches: (N, *PATCH).
        numbers: (N, NUMBERS).
        planned: Actions as planned (N,).
        outcomes: Reward, actions, whether uncovered, occlusion and clutter moved (N, 5).
    """

    patches: Tensor
    numbers: Tensor
    planned: Tensor
    outcomes: Tensor

    @classmethod
    def of(cls, views: PushViews, outcomes: Sequence[PushOutcome]) -> "PushSamples":
        """Return n pushes seen from one observation, with their outcomes."""
        rows = [(o.reward, o.actions, o.uncovered, o.occlusion, o.clutter_moved) for o in outcomes]
        return cls(
            torch.from_numpy(views.patches),
            torch.from_numpy(views.numbers),
            torch.from_numpy(views.actions),
            torch.tensor(rows, dtype=torch.float32).reshape(-1, 5),
        )

    @classmethod
    def joined(cls, parts: Sequence["PushSamples"]) -> "PushSamples":
        """Return all samples of several parts."""
        names = ("patches", "numbers", "planned", "outcomes")
        return cls(*(torch.cat([getattr(part, name) for part in parts]) for name in names))

    def __len__(self) -> int:
        return len(self.planned)


class PushValue(nn.Module):
    """Predicts a push's outcome from its patch and its numbers."""

    def __init__(self, config: PushValueConfig) -> None:
        super().__init__()
        self.config = config
        wide, (first, second) = 2 * config.filters, config.hidden
        self.tower = nn.Sequential(
            nn.Conv2d(PATCH[0], config.filters, 4, 2, 1), nn.ReLU(),
            nn.Conv2d(config.filters, wide, 3, 2, 1), nn.ReLU(),
            nn.Conv2d(wide, wide, 3, 2, 1), nn.ReLU(),
            nn.Flatten(), nn.Dropout(config.dropout),
        )  # fmt: skip
        pixels = (PATCH[1] // 8) * (PATCH[2] // 8)
        self.dense = nn.Sequential(
            nn.Linear(wide * pixels + NUMBERS, first), nn.ReLU(), nn.Dropout(config.dropout),
            nn.Linear(first, second), nn.ReLU(), nn.Linear(second, 4),
        )  # fmt: skip
        self.to(memory_format=torch.channels_last)

    def forward(self, patches: Tensor, numbers: Tensor) -> Tensor:
        """Return what `targets` returns for pushes (B, 4), the second as a logit."""
        features = self.tower(patches.float().contiguous(memory_format=torch.channels_last))
        out: Tensor = self.dense(torch.cat([features, numbers], dim=1))
        return out

    def value(
        self,
        patches: Tensor,
        numbers: Tensor,
        planned: Tensor,
        continuation: Continuation,
        idleness: float,
    ) -> Tensor:
        """Return the rewards expected of pushes and of what follows them (B,).

        Args:
            patches: (B, *PATCH).
            numbers: (B, NUMBERS).
            planned: Actions as planned (B,).
            continuation: What follows a push that leaves the target covered.
            idleness: Cost of an action.
        """
        reward, uncovered, occlusion, actions = self.expected(patches, numbers, planned)
        return reward - idleness * actions + (1 - uncovered) * continuation.value(occlusion)

    def expected(
        self, patches: Tensor, numbers: Tensor, planned: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return what is expected of pushes, each (B,); arguments are those of `value`.

        Returns:
            Reward without idleness, the probability that it uncovers the target, occlusion
            afterwards, actions.
        """
        out = self(patches, numbers)
        actions = planned + _ACTIONS * out[:, 3]
        return _REWARD * out[:, 0], torch.sigmoid(out[:, 1]), out[:, 2], actions


class Judgement(nn.Module):
    """Some networks as one, to be run elsewhere than in PyTorch."""

    def __init__(
        self, networks: Sequence[PushValue], continuation: Continuation, idleness: float
    ) -> None:
        super().__init__()
        self.networks = nn.ModuleList(networks)
        self.continuation, self.idleness = continuation, idleness

    def forward(
        self, patches: Tensor, numbers: Tensor, planned: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return values (B,), and probabilities, occlusions and actions by network (K, B)."""
        networks = cast(Iterable[PushValue], self.networks)
        found = [network.expected(patches, numbers, planned) for network in networks]
        reward, uncovered, occlusion, actions = map(torch.stack, zip(*found, strict=True))
        later = (1 - uncovered) * self.continuation.value(occlusion)
        value = (reward - self.idleness * actions + later).mean(dim=0)
        return value, uncovered, occlusion, actions


def targets(samples: PushSamples, config: PushValueConfig) -> Tensor:
    """Return what the network is to predict of pushes (N, 4).

    Reward without idleness, but with the cost of moving clutter; whether the target was uncovered;
    its occlusion afterwards; actions beyond the planned. Rewards and actions are scaled.
    """
    reward, actions, uncovered, occlusion, clutter = samples.outcomes.T
    gentle = reward.clamp(_LOWEST, _HIGHEST) - config.gentleness * clutter
    return torch.stack(
        [gentle / _REWARD, uncovered, occlusion, (actions - samples.planned) / _ACTIONS], dim=1
    )


def fit_pushes(network: PushValue, samples: PushSamples, seed: int) -> float:
    """Fit a network to outcomes; return the last epoch's mean loss.

    Straight pushes are mirrored at random, since left and right are alike; the others are drawn
    both ways, and look the same in their own frame.

    Args:
        network: Whose weights change.
        samples: At least one.
        seed: Of batches and dropout; torch's own generator is set to it.
    """
    config, wanted = network.config, targets(samples, network.config)
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    steps = max(round(config.epochs * len(samples) / config.batch), 1)
    optimizer = torch.optim.AdamW(
        network.parameters(), config.rate, weight_decay=config.weight_decay, fused=True
    )
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, config.rate, steps)
    losses = []
    network.train()
    for _ in range(steps):
        rows = torch.from_numpy(rng.integers(len(samples), size=config.batch))
        patches, numbers = _mirrored(samples, rows, torch.from_numpy(rng.random(len(rows)) < 0.5))
        loss = _loss(network(patches, numbers), wanted[rows])
        optimizer.zero_grad()
        torch.autograd.backward(loss)
        optimizer.step()
        schedule.step()
        losses.append(loss.item())
    network.eval()
    return float(np.mean(losses[-max(len(samples) // config.batch, 1) :]))


def _mirrored(samples: PushSamples, rows: Tensor, flip: Tensor) -> tuple[Tensor, Tensor]:
    patches, numbers = samples.patches[rows], samples.numbers[rows]
    flip = flip & (numbers[:, STRAIGHT_NUMBER] > 0)
    patches = torch.where(flip[:, None, None, None], patches.flip(-2), patches)
    signs = torch.ones(NUMBERS)
    signs[list(MIRRORED_NUMBERS)] = -1
    return patches, torch.where(flip[:, None], numbers * signs, numbers)


def _loss(found: Tensor, wanted: Tensor) -> Tensor:
    return (
        functional.huber_loss(found[:, 0], wanted[:, 0])
        + functional.binary_cross_entropy_with_logits(found[:, 1], wanted[:, 1])
        + 2 * functional.mse_loss(found[:, 2], wanted[:, 2])
        + functional.huber_loss(found[:, 3], wanted[:, 3])
    )
