"""Train grasp networks and quality networks on grasps that were tried; epochs can be resumed."""

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from mechsearch.files import CHECKPOINT_FILE, NETWORK_FILE, alone
from mechsearch.files.tensors import resume, save_progress
from mechsearch.grasp.learning.grasp_folder import Labelled
from mechsearch.grasp.learning.labelling import Grasps, Trials
from mechsearch.grasp.learning.metrics import NetworkComparison, Verdict, compare, judge
from mechsearch.grasp.network import GraspNetwork, load_network, ready, save_network
from mechsearch.grasp.quality_network import (
    QualityNetwork,
    load_quality_network,
    mirrored,
    save_quality_network,
)
from mechsearch.grippers import ANGLES
from mechsearch.heaps.dataset import evenly_spread
from mechsearch.processes import Progress, silent
from mechsearch.types import Array, Floats, MechSearchError

_KIND = "mechsearch grasp training"

_LOGGED = ("average_precision", "auc", "brier", "base_rate")


@dataclass(frozen=True)
class GraspTrainConfig:
    """How to train.

    Attributes:
        epochs: Passes over the grasps.
        batch: Grasps in one update.
        learning_rate: Of Adam, at first; it falls to zero along half a cosine.
        weight_decay: Of all weights.
        turned: Whether each grasp is mirrored and turned at random, its closing direction likewise.
        validation: Share of the heaps that no update sees; they choose the best epoch.
        seed: Of weights, order, mirrors and turns.
    """

    epochs: int = 20
    batch: int = 64
    learning_rate: float = 1e-3
    weight_decay: float = 1e-4
    turned: bool = True
    validation: float = 0.15
    seed: int = 0

    def __post_init__(self) -> None:
        if self.epochs < 1 or self.batch < 1 or self.learning_rate <= 0:
            raise MechSearchError(
                f"{self.epochs} epochs in batches of {self.batch} at a learning rate of "
                f"{self.learning_rate}; expected at least 1, 1 and more than 0"
            )
        if not 0.0 < self.validation < 1.0:
            raise MechSearchError(f"a validation share of {self.validation}; expected 0 to 1")


def train_grasp_network(
    grasps: Grasps, config: GraspTrainConfig, folder: Path, progress: Progress = silent
) -> list[dict[str, float]]:
    """Train a network, or go on; write the best one as `network.safetensors`.

    Args:
        grasps: Labelled grasps of at least two heaps.
        config: How to train; only `epochs` may differ from what a folder was begun with.
        folder: For checkpoint and network.
        progress: Told after each epoch.

    Returns:
        For each epoch its mean loss and, on the validation heaps, average precision and AUC.

    Raises:
        MechSearchError: If there are too few heaps, the validation heaps' labels are all alike, or
            the folder holds another training, or another process is at work in it.
    """
    learn, check = split_by_heap(grasps, config.validation)
    network = _fresh(learn, config)
    success = torch.from_numpy(learn.success.astype(np.int64))

    def loss(own: Array, rng: np.random.Generator) -> Tensor:
        symmetry = rng.integers(8, size=len(own)) * config.turned
        logits = _logits(network, *turned(learn.relative[own], learn.bin[own], symmetry))
        return nn.functional.cross_entropy(logits, success[own])

    return fit(
        network, len(learn), loss, lambda: judge(predict(network, check), check.success),
        lambda path, meta: save_network(path, network, meta),
        config, {"grasps": len(grasps)}, folder, progress,
    )  # fmt: skip


def fit(
    network: nn.Module,
    count: int,
    loss: Callable[[Array, np.random.Generator], Tensor],
    verdict: Callable[[], Verdict],
    save: Callable[[Path, dict[str, object]], None],
    config: GraspTrainConfig,
    data: Mapping[str, Any],
    folder: Path,
    progress: Progress = silent,
) -> list[dict[str, float]]:
    """Fit a network's weights, or go on; write the best one as `network.safetensors`.

    Args:
        network: With its first weights.
        count: Of grasps to learn from.
        loss: Returns the mean loss of some grasps, by indices, as the network now is.
        verdict: Judges it on grasps that it does not learn from.
        save: Writes it to a file, with plain JSON about it.
        config: How to train; only `epochs` may differ from what a folder was begun with.
        data: What tells these grasps from others, as plain JSON.
        folder: For checkpoint and network.
        progress: Told after each epoch.

    Returns:
        For each epoch its mean loss and, on the validation heaps, average precision and AUC.

    Raises:
        MechSearchError: If the folder holds another training, or another process is at work in it.
    """
    with alone(folder / "training", f"the training {folder}"):
        optimizer = torch.optim.AdamW(
            network.parameters(), config.learning_rate, weight_decay=config.weight_decay
        )
        identity = {**asdict(replace(config, epochs=1)), **data}
        history = resume(folder / CHECKPOINT_FILE, _KIND, identity, network, optimizer)
        for epoch in range(len(history), config.epochs):
            mean = _train(network, optimizer, count, loss, config, epoch)
            found = verdict()
            history.append({"loss": mean, **{name: getattr(found, name) for name in _LOGGED}})
            best = max(row["average_precision"] for row in history)
            if history[-1]["average_precision"] == best:
                save(folder / NETWORK_FILE, {"validation": history[-1]})
            save_progress(folder / CHECKPOINT_FILE, _KIND, identity, network, optimizer, history)
            label = f"epochs, loss {mean:.3f}, AP {found.average_precision:.3f}, best {best:.3f}"
            progress(label, epoch + 1, config.epochs)
        return history


def split_by_heap(grasps: Labelled, share: float) -> tuple[Labelled, Labelled]:
    """Return the grasps to learn from and to check on; no heap is in both.

    Raises:
        MechSearchError: If there are fewer than two heaps.
    """
    heaps = np.unique(grasps.heap)
    if len(heaps) < 2:
        raise MechSearchError(f"grasps of {len(heaps)} heap; expected at least 2")
    number = min(max(1, round(share * len(heaps))), len(heaps) - 1)
    held = heaps[evenly_spread(len(heaps), number)]
    inside = np.isin(grasps.heap, held)
    return grasps.where(~inside), grasps.where(inside)


@torch.inference_mode()
def predict(
    network: GraspNetwork,
    grasps: Grasps,
    batch: int = 256,
    told: Callable[[int, int], object] = lambda *_: None,
) -> NDArray[np.float64]:
    """Return the quality (n,) of labelled grasps, in each one's own closing direction.

    Args:
        network: To rate them.
        grasps: Labelled grasps.
        batch: Grasps at once.
        told: Told after each batch how many are rated, and of how many.
    """
    network.eval()
    found = []
    for start in range(0, len(grasps), batch):
        own = slice(start, start + batch)
        logits = _logits(network, grasps.relative[own], grasps.bin[own])
        found.append(torch.sigmoid(logits[:, 1] - logits[:, 0]).double().numpy())
        told(min(own.stop, len(grasps)), len(grasps))
    return np.concatenate(found)


def compare_networks(
    grasps: Grasps, networks: Mapping[str, Path | None], progress: Progress = silent
) -> NetworkComparison:
    """Return how good networks are on grasps, and the gain of the first over each other one.

    Args:
        grasps: Labelled grasps that they have not learnt from.
        networks: File of each by name; None is the shipped one.
        progress: Told of the grasps that each has rated.

    Raises:
        MechSearchError: If a network is no good, or all outcomes are alike.
    """
    rated = {
        name: predict(load_network(path), grasps, told=partial(progress, f"rated by {name}"))
        for name, path in networks.items()
    }
    return compare(rated, grasps.success, grasps.heap)


def turned(seen: Array, angle: Array, symmetry: Array) -> tuple[Array, Array]:
    """Return what grasps look like mirrored or turned, and their angle bins.

    Args:
        seen: Images (n, 96, 96), the grasp centre at pixel 48.
        angle: Bins (n,).
        symmetry: Which of eight (n,): 1 mirrors rows, 2 mirrors columns, 4 swaps both.
    """
    out, bins = seen.copy(), np.asarray(angle, np.intp).copy()
    for bit, axis in ((1, 1), (2, 2)):
        own = np.flatnonzero(symmetry & bit)
        # Pixel 48 is the middle of pixels 1 to 95; the odd line out takes its neighbour's place.
        mirrored = np.flip(np.take(out[own], range(1, 96), axis), axis)
        out[own] = np.concatenate([np.take(mirrored, [0], axis), mirrored], axis)
        bins[own] = ANGLES - 1 - bins[own]
    own = np.flatnonzero(symmetry & 4)
    out[own] = out[own].transpose(0, 2, 1)
    bins[own] = (ANGLES // 2 - 1 - bins[own]) % ANGLES
    return out, bins


def _fresh(learn: Grasps, config: GraspTrainConfig) -> GraspNetwork:
    """Return a network with random weights, its input scaled as the grasps are."""
    sample = learn.relative[:: max(1, len(learn) // 4096)].astype(np.float64)
    with torch.random.fork_rng():
        torch.manual_seed(config.seed)
        return ready(GraspNetwork(float(sample.mean()), float(sample.std())))


def _train(
    network: nn.Module,
    optimizer: torch.optim.Optimizer,
    count: int,
    loss: Callable[[Array, np.random.Generator], Tensor],
    config: GraspTrainConfig,
    epoch: int,
) -> float:
    """Go through all grasps once; return the mean loss."""
    network.train()
    share = epoch / config.epochs
    for group in optimizer.param_groups:
        group["lr"] = config.learning_rate * (1 + math.cos(math.pi * share)) / 2
    total = 0.0
    # Of its epoch alone, so that a resumed training is the same training.
    rng = np.random.default_rng([config.seed, epoch])
    order = rng.permutation(count)
    for start in range(0, len(order), config.batch):
        own = order[start : start + config.batch]
        found = loss(own, rng)
        optimizer.zero_grad()
        torch.autograd.backward(found)
        optimizer.step()
        total += float(found.detach()) * len(own)
    return total / count


def _logits(network: GraspNetwork, seen: Array, angle: Array) -> Tensor:
    """Return logits (n, 2) of images (n, 96, 96), in each one's own closing direction (n,)."""
    images = torch.from_numpy(seen.astype(np.float32))[:, None]
    found = network(images.contiguous(memory_format=torch.channels_last))[:, :, :, 0, 0]
    own: Tensor = found[torch.arange(len(seen)), torch.from_numpy(angle.astype(np.int64))]
    return own


def train_quality_network(
    gripper: str,
    trials: Trials,
    config: GraspTrainConfig,
    folder: Path,
    progress: Progress = silent,
) -> list[dict[str, float]]:
    """Train a gripper's network, or go on; write the best one as `network.safetensors`.

    Args:
        gripper: By name.
        trials: Of that gripper, in at least two heaps.
        config: How to train; only `epochs` may differ from what a folder was begun with.
        folder: For checkpoint and network.
        progress: Told after each epoch.

    Returns:
        As `fit` does.

    Raises:
        MechSearchError: If there are too few heaps, the validation heaps' labels are all alike, or
            the folder holds another training, or another process is at work in it.
    """
    learn, check = split_by_heap(trials.where(trials.sound), config.validation)
    with torch.random.fork_rng():
        torch.manual_seed(config.seed)
        network = ready(QualityNetwork(gripper))
    success = torch.from_numpy(learn.success.astype(np.float32))
    symmetries = 8 if network.grid.square else 4

    def loss(own: Array, rng: np.random.Generator) -> Tensor:
        symmetry = rng.integers(symmetries, size=len(own)) * config.turned
        seen = mirrored(
            learn.relative[own].astype(np.float32), learn.target[own], learn.numbers[own], symmetry
        )
        logits = network(*(torch.from_numpy(array) for array in seen))
        return nn.functional.binary_cross_entropy_with_logits(logits, success[own])

    return fit(
        network, len(learn), loss, lambda: judge_trials(predict_trials(network, check), check),
        lambda path, meta: save_quality_network(path, network, meta),
        config, {"gripper": gripper, "grasps": len(trials)}, folder, progress,
    )  # fmt: skip


def predict_trials(network: QualityNetwork, trials: Trials, batch: int = 512) -> Floats:
    """Return the quality (n,) of grasps."""
    network.eval()
    parts = (trials.where(np.arange(s, min(s + batch, len(trials))))
             for s in range(0, len(trials), batch))  # fmt: skip
    return np.concatenate([network.quality(part.seen) for part in parts])


def judge_trials(quality: Floats, trials: Trials) -> Verdict:
    """Return how good qualities (n,) are against both executions of each grasp."""
    return judge(np.repeat(quality, 2), trials.won.ravel())


def compare_quality_networks(
    gripper: str, trials: Trials, networks: Mapping[str, Path | None]
) -> NetworkComparison:
    """Return how good a gripper's networks are, and the gain of the first over each other one.

    Args:
        gripper: By name.
        trials: Of that gripper, that no network has learnt from.
        networks: File of each by name; None is the shipped one.

    Raises:
        MechSearchError: If a network is no good or of another gripper, or all outcomes are alike.
    """
    sound = trials.where(trials.sound)
    rated = {
        name: np.repeat(predict_trials(load_quality_network(gripper, path), sound), 2)
        for name, path in networks.items()
    }
    return compare(rated, sound.won.ravel(), np.repeat(sound.heap, 2))
