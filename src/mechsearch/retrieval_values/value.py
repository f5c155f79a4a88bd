"""What a push or a removal will make of the target's best grasp, and how much clutter it moves."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from mechsearch.retrieval_values.view import (
    MIRRORED_OPTION_NUMBERS,
    NO_OPTIONS,
    OPTION_NUMBERS,
    OPTION_PATCH,
    OptionViews,
)
from mechsearch.types import MechSearchError

_CLUTTER = 0.02
"""Clutter moved that the network calls 1 [m]."""

_MOST_CLUTTER = 5.0
"""More of it, in that unit, teaches nothing more."""


@dataclass(frozen=True)
class RetrievalValueConfig:
    """The network and its fit.

    Attributes:
        filters: Channels of the first convolution; the next two have twice as many.
        hidden: Widths of the dense layers.
        dropout: Share of units dropped while fitting.
        rate: Highest learning rate.
        weight_decay: Of AdamW.
        batch: Options an update.
        epochs: How often a fit sees every option.
        within: Weight of how options of one decision differ, beside what each comes to.
    """

    filters: int = 32
    hidden: tuple[int, int] = (128, 64)
    dropout: float = 0.3
    rate: float = 1.5e-3
    weight_decay: float = 1e-2
    batch: int = 128
    epochs: float = 12.0
    within: float = 4.0

    def __post_init__(self) -> None:
        if not 0 <= self.dropout < 1:
            raise MechSearchError(f"dropout is {self.dropout}; expected a share in [0, 1)")
        for name in ("filters", "rate", "batch", "epochs"):
            if getattr(self, name) <= 0:
                raise MechSearchError(f"{name} is {getattr(self, name)}; expected more than 0")


@dataclass(frozen=True)
class OptionOutcomes:
    """What options (n,) came to.

    Attributes:
        chance: That the best grasp succeeds afterwards, in [0, 1]; 0 where the target was lost.
        clutter_moved: Sum over the actions of the mean non-target displacement [m].
    """

    chance: Tensor
    clutter_moved: Tensor


@dataclass(frozen=True)
class OptionSamples:
    """Options that were tried, and what they came to, as tensors.

    Attributes:
        patches: (N, *OPTION_PATCH).
        numbers: (N, OPTION_NUMBERS).
        chance: Afterwards (N,).
        clutter: Moved (N,) [m].
        decision: Number of the decision (N,), in order: its options were tried from one state.
    """

    patches: Tensor
    numbers: Tensor
    chance: Tensor
    clutter: Tensor
    decision: Tensor

    @classmethod
    def of(
        cls, views: OptionViews, chances: Sequence[float], clutter: Sequence[float]
    ) -> "OptionSamples":
        """Return the n options of one decision."""
        return cls(
            torch.from_numpy(views.patches),
            torch.from_numpy(views.numbers),
            torch.tensor(chances, dtype=torch.float32),
            torch.tensor(clutter, dtype=torch.float32),
            torch.zeros(len(chances), dtype=torch.int64),
        )

    @classmethod
    def joined(cls, parts: Sequence["OptionSamples"]) -> "OptionSamples":
        """Return all samples of several parts, if any, their decisions numbered on."""
        parts = (cls.of(NO_OPTIONS, [], []), *parts)
        names = ("patches", "numbers", "chance", "clutter")
        rows, begun = [], 0
        for own in parts:
            rows.append(own.decision + begun)
            begun += int(own.decision.max()) + 1 if len(own) else 0
        joined = {name: torch.cat([getattr(own, name) for own in parts]) for name in names}
        return cls(**joined, decision=torch.cat(rows))

    def __len__(self) -> int:
        return len(self.chance)


class RetrievalValue(nn.Module):
    """Predicts what an option comes to from its patch and its numbers."""

    def __init__(self, config: RetrievalValueConfig) -> None:
        super().__init__()
        self.config = config
        wide, (first, second) = 2 * config.filters, config.hidden
        self.tower = nn.Sequential(
            nn.Conv2d(OPTION_PATCH[0], config.filters, 4, 2, 1), nn.ReLU(),
            nn.Conv2d(config.filters, wide, 3, 2, 1), nn.ReLU(),
            nn.Conv2d(wide, wide, 3, 2, 1), nn.ReLU(),
            nn.Flatten(), nn.Dropout(config.dropout),
        )  # fmt: skip
        pixels = (OPTION_PATCH[1] // 8) * (OPTION_PATCH[2] // 8)
        self.dense = nn.Sequential(
            nn.Linear(wide * pixels + OPTION_NUMBERS, first), nn.ReLU(), nn.Dropout(config.dropout),
            nn.Linear(first, second), nn.ReLU(), nn.Linear(second, 2),
        )  # fmt: skip
        self.to(memory_format=torch.channels_last)

    def forward(self, patches: Tensor, numbers: Tensor) -> Tensor:
        """Return the chance afterwards as a logit, and the clutter moved in 2 cm (B, 2)."""
        features = self.tower(patches.float().contiguous(memory_format=torch.channels_last))
        out: Tensor = self.dense(torch.cat([features, numbers], dim=1))
        return out

    @torch.inference_mode()
    def predict(self, patches: Tensor, numbers: Tensor) -> OptionOutcomes:
        """Return what options are expected to come to."""
        out = self(patches, numbers)
        return OptionOutcomes(torch.sigmoid(out[:, 0]), _CLUTTER * out[:, 1].clamp(min=0))


def fit_options(network: RetrievalValue, samples: OptionSamples, seed: int) -> float:
    """Fit a network to outcomes; return the last epoch's mean loss.

    All options of a decision are seen together, each mirrored at random. What counts most is how
    they differ: a decision only chooses among them.

    Args:
        network: Whose weights change.
        samples: At least one.
        seed: Of batches, mirrors and dropout; torch's own generator is set to it.
    """
    config = network.config
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    groups = np.split(
        np.arange(len(samples)), np.flatnonzero(np.diff(samples.decision.numpy())) + 1
    )
    each = max(1, round(config.batch * len(groups) / len(samples)))
    steps = max(round(config.epochs * len(groups) / each), 1)
    optimizer = torch.optim.AdamW(
        network.parameters(), config.rate, weight_decay=config.weight_decay, fused=True
    )
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, config.rate, steps)
    losses = []
    network.train()
    for _ in range(steps):
        chosen = [groups[i] for i in rng.integers(len(groups), size=each)]
        rows = torch.from_numpy(np.concatenate(chosen))
        group = torch.from_numpy(np.repeat(np.arange(each), [len(own) for own in chosen]))
        patches, numbers = _mirrored(samples, rows, torch.from_numpy(rng.random(len(rows)) < 0.5))
        out = network(patches, numbers)
        loss = option_loss(out, samples.chance[rows], samples.clutter[rows], group, config.within)
        optimizer.zero_grad()
        torch.autograd.backward(loss)
        optimizer.step()
        schedule.step()
        losses.append(loss.item())
    network.eval()
    return float(np.mean(losses[-max(len(groups) // each, 1) :]))


def _mirrored(samples: OptionSamples, rows: Tensor, flip: Tensor) -> tuple[Tensor, Tensor]:
    patches, numbers = samples.patches[rows], samples.numbers[rows]
    patches = torch.where(flip[:, None, None, None], patches.flip(-2), patches)
    signs = torch.ones(OPTION_NUMBERS)
    signs[list(MIRRORED_OPTION_NUMBERS)] = -1
    return patches, torch.where(flip[:, None], numbers * signs, numbers)


def option_loss(
    out: Tensor, chance: Tensor, clutter: Tensor, decision: Tensor, within: float
) -> Tensor:
    """Return how far a network is off what options (B,) came to.

    Args:
        out: Its output (B, 2).
        chance: What they came to (B,); see `OptionSamples`.
        clutter: Likewise (B,) [m].
        decision: Number of the decision (B,), from 0 on.
        within: Weight of how options of one decision differ, beside what each comes to.
    """
    off = torch.sigmoid(out[:, 0]) - chance
    count = torch.zeros(int(decision.max()) + 1).index_add(0, decision, torch.ones(len(decision)))
    mean = torch.zeros(len(count)).index_add(0, decision, off) / count
    moved = (clutter / _CLUTTER).clamp(max=_MOST_CLUTTER)
    return (
        functional.binary_cross_entropy_with_logits(out[:, 0], chance)
        + within * (off - mean[decision]).square().mean()
        + functional.huber_loss(out[:, 1], moved)
    )
