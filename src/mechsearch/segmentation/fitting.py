"""The loop of the trainings on images: updates, from time to time scores and a checkpoint."""

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from torch import nn

from mechsearch.files import CHECKPOINT_FILE
from mechsearch.files.tensors import resume, save_progress
from mechsearch.processes import Progress
from mechsearch.types import MechSearchError

_EVERY, _RISING = 500, 200
"""Updates between checkpoints, and those in which the learning rate rises."""


@dataclass(frozen=True)
class FitConfig:
    """How to train.

    Attributes:
        updates: In all.
        batch: Examples in an update.
        learning_rate: Of AdamW, at its highest; it rises linearly, then falls along a cosine.
        weight_decay: Of all weights.
        validation: Share of the heaps that no update sees; what is sure is calibrated on them.
        seed: Of weights, order and all that is drawn.
    """

    updates: int = 6000
    batch: int = 8
    learning_rate: float = 2e-3
    weight_decay: float = 0.01
    validation: float = 0.05
    seed: int = 0

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if name not in ("weight_decay", "validation", "seed") and value <= 0:
                raise MechSearchError(f"{name} is {value}; expected more than 0")
        if not 0.0 < self.validation < 1.0:
            raise MechSearchError(f"a validation share of {self.validation}; expected 0 to 1")


def fit_by_updates(
    network: nn.Module,
    config: FitConfig,
    folder: Path,
    kind: str,
    others: Mapping[str, Any],
    update: Callable[[torch.optim.Optimizer, int], float],
    scores: Callable[[], Mapping[str, float]],
    progress: Progress,
) -> list[dict[str, float]]:
    """Make all updates, or those that are left of a training that was cut off.

    Args:
        network: Whose weights change.
        config: How to train.
        folder: For the checkpoint.
        kind: What that is; see `Archive`.
        others: What makes the training this one, beside its configuration.
        update: Makes the update of a number, and returns its loss.
        scores: Returns how good the network is on what no update sees.
        progress: Told after each update.

    Returns:
        For each checkpoint the mean loss since the last one, and the scores.

    Raises:
        MechSearchError: If the folder holds another training.
    """
    optimizer = torch.optim.AdamW(
        network.parameters(), config.learning_rate, weight_decay=config.weight_decay
    )
    checkpoint, identity = folder / CHECKPOINT_FILE, {**asdict(config), **others}
    history = resume(checkpoint, kind, identity, network, optimizer)
    for first in range(len(history) * _EVERY, config.updates, _EVERY):
        end = min(first + _EVERY, config.updates)
        loss = 0.0
        network.train()
        for number in range(first, end):
            rise, share = min(1.0, (number + 1) / _RISING), number / config.updates
            for group in optimizer.param_groups:
                group["lr"] = config.learning_rate * rise * (1 + math.cos(math.pi * share)) / 2
            loss += update(optimizer, number)
            label = f"updates, loss {loss / (number + 1 - first):.3f}"
            progress(label, number + 1, config.updates)
        history.append({"loss": loss / (end - first), **scores()})
        save_progress(checkpoint, kind, identity, network, optimizer, history)
    return history
