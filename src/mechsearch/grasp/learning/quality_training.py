"""Train a grasp quality network on grasps that were tried."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from mechsearch.grasp.learning.metrics import NetworkComparison, Verdict, compare, judge
from mechsearch.grasp.learning.training import GraspTrainConfig, fit, split_by_heap
from mechsearch.grasp.learning.trials import Trials
from mechsearch.grasp.quality_network import (
    QualityNetwork,
    load_quality_network,
    mirrored,
    ready,
    save_quality_network,
)
from mechsearch.processes import Progress, silent
from mechsearch.types import Array, Floats


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
        network, len(learn), loss, lambda: judge_trials(predict(network, check), check),
        lambda path, meta: save_quality_network(path, network, meta),
        config, {"gripper": gripper, "grasps": len(trials)}, folder, progress,
    )  # fmt: skip


def predict(network: QualityNetwork, trials: Trials, batch: int = 512) -> Floats:
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
        name: np.repeat(predict(load_quality_network(gripper, path), sound), 2)
        for name, path in networks.items()
    }
    return compare(rated, sound.won.ravel(), np.repeat(sound.heap, 2))
