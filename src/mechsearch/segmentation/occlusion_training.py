"""Train the network that estimates occlusion on images of heaps; a training can be resumed."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, binary_erosion
from scipy.optimize import minimize
from torch.nn import functional

from mechsearch.files import NETWORK_FILE, alone
from mechsearch.processes import Progress, silent
from mechsearch.segmentation.fitting import FitConfig, fit_by_updates
from mechsearch.segmentation.images import Images, ImageSet
from mechsearch.segmentation.occlusion import can_be_judged, patch_of, silhouette_areas
from mechsearch.segmentation.occlusion_network import OcclusionNetwork, save_occlusion_network
from mechsearch.types import CALLED_UNCOVERED, Array, Floats, MechSearchError

_KIND = "mechsearch occlusion training"

_OBJECTS = 4
"""Of an image, from which is learnt."""


@dataclass(frozen=True)
class OcclusionTrainConfig(FitConfig):
    """How to train; a batch is of objects."""

    batch: int = 192


@dataclass(frozen=True, eq=False)
class Examples:
    """What is seen of objects (n,), and the truth.

    Attributes:
        patch: About each (n, 3, 48, 48); see `patch_of`.
        numbers: Of each (n, 5).
        hidden: Share that is hidden (n,).
    """

    patch: NDArray[np.float16]
    numbers: NDArray[np.float32]
    hidden: NDArray[np.float32]


def train_occlusion(
    seen: ImageSet, config: OcclusionTrainConfig, folder: Path, progress: Progress = silent
) -> list[dict[str, float]]:
    """Train a network, or go on; write it as `network.safetensors`, its chances calibrated.

    Args:
        seen: Images of at least two heaps, and the objects on them.
        config: How to train; a folder goes on only as it was begun.
        folder: For checkpoint and network.
        progress: Told after some updates.

    Returns:
        For each checkpoint the mean loss since the last one and, on the validation heaps, what
        `scores` returns.

    Raises:
        MechSearchError: If there are too few heaps, the folder holds another training, or another
            process is at work in it.
    """
    with alone(folder / "training", f"the training {folder}"):
        torch.set_num_threads(1)
        images = seen.images
        learn, check = images.apart(config.validation)
        areas = [silhouette_areas(views.mask, views.width) for views in seen.references]
        torch.manual_seed(config.seed)
        network = OcclusionNetwork().to(memory_format=torch.channels_last)
        rng = np.random.default_rng([config.seed, 1])
        learnt, judged = (examples(images, own, areas, rng) for own in (learn, check))
        network.scale(torch.from_numpy(learnt.numbers))
        history = fit_by_updates(
            network, config, folder, _KIND, {"images_seen": len(images)},
            lambda optimizer, number: _update(network, optimizer, learnt, config, number),
            lambda: scores(_asked(network, judged), judged.hidden),
            progress,
        )  # fmt: skip
        calibration = fitted_chance(
            _asked(network, judged)[:, 0], judged.hidden <= CALLED_UNCOVERED
        )
        about = {"validation": history[-1]}
        save_occlusion_network(folder / NETWORK_FILE, network, calibration, about)
        return history


def examples(
    images: Images, chosen: Array, areas: Sequence[Floats], rng: np.random.Generator
) -> Examples:
    """Return some objects on some images, their masks with errors and without.

    Args:
        images: With the truth.
        chosen: Numbers of images (n,).
        areas: Of all objects' silhouettes (3,); see `silhouette_areas`.
        rng: Draws the objects and errors.
    """
    rows, side = [], images.side // 2
    for index in chosen.tolist():
        ids = images.shown(index, side)
        hidden, objects = images.hidden[index], images.objects[index]
        visible = np.bincount(ids.ravel(), minlength=len(hidden) + 1)[1 : len(hidden) + 1]
        places = np.flatnonzero((visible > 0) & (objects >= 0))
        _, depth, camera = images.seen(index, side)
        for place in rng.permutation(places)[:_OBJECTS].tolist():
            mask = _with_errors(ids == place + 1, rng)
            if not can_be_judged(depth, mask):
                continue
            patch, numbers = patch_of(depth, camera, mask, areas[objects[place]])
            rows.append((patch.astype(np.float16), numbers, hidden[place]))
    if not rows:
        raise MechSearchError("none of the images shows an object; expected some")
    return Examples(*(np.array(column) for column in zip(*rows, strict=True)))


def _with_errors(mask: NDArray[np.bool_], rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return a mask whose border is off by a pixel, or of which a part is missing, or neither."""
    kind = rng.random()
    if kind > 0.55:
        return mask
    pixels = np.argwhere(mask)
    where = tuple(
        slice(max(low - 2, 0), high + 3)
        for low, high in zip(pixels.min(0).tolist(), pixels.max(0).tolist(), strict=True)
    )
    own, wrong = mask[where], mask.copy()
    if kind < 0.15:
        wrong[where] = binary_erosion(own)
    elif kind < 0.3:
        wrong[where] = binary_dilation(own)
    elif kind < 0.5:
        border = binary_dilation(own) ^ binary_erosion(own)
        wrong[where] = own ^ (border & (rng.random(own.shape) < 0.3))
    else:
        away = pixels - pixels[rng.integers(len(pixels))]
        wrong[tuple(pixels[(away**2).sum(axis=1) <= rng.uniform(1, 9)].T)] = False
    return wrong


def _update(
    network: OcclusionNetwork,
    optimizer: torch.optim.Optimizer,
    learnt: Examples,
    config: OcclusionTrainConfig,
    number: int,
) -> float:
    """Make one update by examples that are drawn, turned and mirrored; return its loss."""
    # Of its number alone, so that a resumed training is the same training.
    torch.manual_seed(config.seed + number)
    drawn = torch.randint(len(learnt.hidden), (config.batch,)).numpy()
    parts = (learnt.patch[drawn], learnt.numbers[drawn], learnt.hidden[drawn])
    patch, numbers, hidden = (torch.from_numpy(part).float() for part in parts)
    turn, mirrored = torch.randint(4, (2,)).tolist()
    patch = torch.rot90(patch, turn, (2, 3))
    if mirrored % 2:
        patch = patch.flip(3)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        found = network(patch.contiguous(memory_format=torch.channels_last), numbers).float()
    sure = functional.binary_cross_entropy_with_logits(
        found[:, 0], (hidden <= CALLED_UNCOVERED).float()
    )
    loss = sure + 2 * functional.mse_loss(torch.sigmoid(found[:, 1]), hidden)
    optimizer.zero_grad()
    torch.autograd.backward(loss)
    optimizer.step()
    return float(loss.detach())


def _asked(network: OcclusionNetwork, judged: Examples) -> Floats:
    """Return logits (n, 2); see `OcclusionNetwork`."""
    network.eval()
    found = []
    with torch.inference_mode():
        for start in range(0, len(judged.hidden), 256):
            part = slice(start, start + 256)
            patch, numbers = map(torch.from_numpy, (judged.patch[part], judged.numbers[part]))
            found.append(network(patch.float(), numbers).numpy())
    return np.concatenate(found).astype(np.float64)


def scores(logits: Floats, hidden: Array) -> dict[str, float]:
    """Return how good estimates are.

    Args:
        logits: From a network (n, 2).
        hidden: Share that is hidden (n,).

    Returns:
        The mean absolute error of occlusion, the average precision of being uncovered, and the
        share of uncovered objects that are found at 95 % precision.
    """
    order = np.argsort(-logits[:, 0], kind="stable")
    right = (hidden <= CALLED_UNCOVERED)[order]
    precision = right.cumsum() / np.arange(1, len(right) + 1)
    fine = np.flatnonzero(precision >= 0.95)
    count = max(int(right.sum()), 1)
    return {
        "error": float(np.abs(1 / (1 + np.exp(-logits[:, 1])) - hidden).mean()),
        "average_precision": float(precision[right].sum() / count),
        "recall": float(right[: fine[-1] + 1].sum() / count) if len(fine) else 0.0,
    }


def fitted_chance(logits: Floats, right: Array) -> list[float]:
    """Return factor and offset of logits (n,) whose logistic is the chance of being right (n,)."""
    sign = np.where(right, -1.0, 1.0)

    def loss(weights: Floats) -> float:
        return float(np.logaddexp(0, sign * (weights[0] * logits + weights[1])).mean())

    return [float(weight) for weight in minimize(loss, np.array([1.0, 0.0])).x]
