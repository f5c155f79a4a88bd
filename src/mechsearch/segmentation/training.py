"""Train the segmentation network on images of heaps; a training can be resumed."""

import copy
import hashlib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import minimize
from torch import Tensor
from torch.nn import functional

from mechsearch.files import NETWORK_FILE, alone
from mechsearch.observe.masks import image_channels, mask_features, surest_parts
from mechsearch.processes import Progress, silent
from mechsearch.segmentation.fitting import FitConfig, fit_by_updates
from mechsearch.segmentation.images import Images, ImageSet
from mechsearch.segmentation.judging import found_by, partly_hidden
from mechsearch.segmentation.network import (
    NetworkSegmenter,
    SegmentationNetwork,
    load_segmentation_network,
    reference_channels,
    save_segmentation_network,
)
from mechsearch.types import Array, Floats

_KIND = "mechsearch segmentation training"

_CROP, _LEAST = 80, 8
"""Side of what training sees of an image, and pixels of a target from which on it is one."""

_SIZES = 0.85, 1.05
"""Least and greatest size of an image, beside those at which targets are looked for."""

_CHECKED, _CALIBRATED = 200, 800
"""Targets on which checkpoints are judged, and the last one is calibrated."""

_BOUNDS = tuple(np.arange(-1.0, 2.01, 0.25).tolist())
"""Logits from which pixels may be taken into a mask."""


@dataclass(frozen=True)
class SegmentTrainConfig(FitConfig):
    """How to train; a batch is of images.

    Attributes:
        targets: Looked for on each image.
        views: Reference views of each target.
    """

    targets: int = 6
    views: int = 6


def train_segmentation(
    seen: ImageSet,
    config: SegmentTrainConfig,
    folder: Path,
    start: Path | None = None,
    progress: Progress = silent,
) -> list[dict[str, float]]:
    """Train a network, or go on; write it as `network.safetensors`, its confidence calibrated.

    Args:
        seen: Images of at least two heaps, and the objects on them.
        config: How to train; a folder goes on only as it was begun.
        folder: For checkpoint and network.
        start: Network whose weights are the first ones; None draws them.
        progress: Told after some updates.

    Returns:
        For each checkpoint the mean loss since the last one and, on the validation heaps, the mean
        IoU of targets that are less and more than half hidden, and the share of masks on the right
        object.

    Raises:
        MechSearchError: If there are too few heaps, the folder holds another training, or another
            process is at work in it.
    """
    with alone(folder / "training", f"the training {folder}"):
        torch.set_num_threads(1)
        images = seen.images
        learn, check = images.apart(config.validation)
        torch.manual_seed(config.seed)
        network = SegmentationNetwork() if start is None else load_segmentation_network(start)[0]
        network = network.to(memory_format=torch.channels_last).requires_grad_(True)
        begun = None if start is None else hashlib.sha256(start.read_bytes()).hexdigest()
        views = _stacked(seen.references)
        held_out = replace(seen, images=images.where(check))
        wanted = partly_hidden(held_out.images, targets=False)
        few, many = (wanted[:: max(1, len(wanted) // n)] for n in (_CHECKED, _CALIBRATED))
        history = fit_by_updates(
            network, config, folder, _KIND, {"images_seen": len(images), "start": begun},
            lambda optimizer, number: _update(
                network, optimizer, images, learn, views, config, number
            ),
            lambda: found_by(NetworkSegmenter(network, (1.0, 0.0, 0.0)), held_out, few).summary,
            progress,
        )  # fmt: skip
        bound, confidence = calibrated(NetworkSegmenter(network, ()), held_out, many)
        network.raise_bound(bound)
        about = {"validation": history[-1]}
        save_segmentation_network(folder / NETWORK_FILE, network, confidence, about)
        return history


def calibrated(
    segmenter: NetworkSegmenter, seen: ImageSet, wanted: Sequence[tuple[int, int]]
) -> tuple[float, list[float]]:
    """Return how sure pixels and masks have to be.

    Returns:
        The logit above which pixels are best taken into a mask: mean IoU and the share of right
        masks are highest together. Then, of logits less that, the weights (3,) of `mask_features`
        and 1 whose logistic is a mask's chance to be right.
    """
    found, images = [], seen.images
    for index, place in wanted:
        segmenter.look_for(seen.references[int(images.objects[index, place])])
        logits = segmenter.logits(*images.seen(index)).astype(np.float16)
        found.append((logits, images.ids[index] == place + 1))

    def scores(bound: float) -> Floats:
        rows = [(surest_parts(logits - bound), truth) for logits, truth in found]
        return np.array([
            ((m & t).sum() / (m | t).sum(), (m & t).sum() > 0.5 * m.sum()) for m, t in rows
        ], np.float64)  # fmt: skip

    bound = max(_BOUNDS, key=lambda b: float(scores(b).mean()))
    wrong = np.where(scores(bound)[:, 1] > 0, -1.0, 1.0)
    x = np.array([
        [*mask_features(own := logits - bound, surest_parts(own)), 1.0] for logits, _ in found
    ])  # fmt: skip

    def loss(weights: Floats) -> float:
        return float(np.logaddexp(0, wrong * (x @ weights)).mean() + 1e-4 * (weights**2).sum())

    return bound, [float(weight) for weight in minimize(loss, np.zeros(3)).x]


def _stacked(references: Sequence[Any]) -> tuple[Tensor, Tensor, Tensor]:
    """Return colours, masks and widths of all objects' views."""
    return (
        torch.from_numpy(np.stack([r.rgb for r in references])),
        torch.from_numpy(np.stack([r.mask for r in references])),
        torch.from_numpy(np.stack([r.width for r in references])),
    )


def _update(
    network: SegmentationNetwork,
    optimizer: torch.optim.Optimizer,
    images: Images,
    learn: Array,
    references: tuple[Tensor, Tensor, Tensor],
    config: SegmentTrainConfig,
    number: int,
) -> float:
    """Make one update; return its loss."""
    # Of its number alone, so that a resumed training is the same training.
    rng = np.random.default_rng([config.seed, number])
    seen, truths, numbers = [], [], []
    for index in rng.choice(learn, config.batch):
        crop, own, drawn = _example(images, int(index), len(references[0]), config.targets, rng)
        seen.append(crop)
        truths.append(own)
        numbers.append(drawn)
    truth = torch.from_numpy(np.concatenate(truths)).float()
    views = _views(references, np.concatenate(numbers), config.views, rng)
    halves = zip(
        torch.from_numpy(np.stack(seen)).chunk(2), views.chunk(2), truth.chunk(2), strict=True
    )
    # Two threads with a network each wait for one another once, not at every operation.
    replicas = [copy.deepcopy(network) for _ in range(2)]
    with ThreadPoolExecutor(2) as pool:
        losses = list(pool.map(_backward, replicas, *zip(*halves, strict=True)))
    for own, *others in zip(network.parameters(), *(r.parameters() for r in replicas), strict=True):
        own.grad = torch.stack([other.grad for other in others]).mean(0)
    network.load_state_dict(replicas[0].state_dict())
    torch.nn.utils.clip_grad_norm_(network.parameters(), 2.0)
    optimizer.step()
    return sum(losses) / 2


def _backward(
    network: SegmentationNetwork, images: Tensor, references: Tensor, truth: Tensor
) -> float:
    """Leave the gradient of a loss in a network; return the loss."""
    image = torch.arange(len(images)).repeat_interleave(len(references) // len(images))
    # Threads share one store of rounded weights for a second use, which whoever is done empties.
    with torch.autocast("cpu", dtype=torch.bfloat16, cache_enabled=False):
        logits = network.decode(network.encode(images), network.look(references), image)
    loss = _loss(logits.float(), truth)
    torch.autograd.backward(loss)
    return float(loss.detach())


def _loss(logits: Tensor, truth: Tensor) -> Tensor:
    """Return cross-entropy, by the size of what there is to find, and one minus a soft Dice."""
    size = truth.sum((1, 2))
    entropy = functional.binary_cross_entropy_with_logits(logits, truth, reduction="none")
    chance = torch.sigmoid(logits)
    dice = 1 - (2 * (chance * truth).sum((1, 2)) + 1) / (chance.sum((1, 2)) + size + 1)
    return (entropy.sum((1, 2)) / (size + 100)).mean() + (dice * (size > 0)).mean()


def _example(
    images: Images, index: int, objects: int, targets: int, rng: np.random.Generator
) -> tuple[Array, Array, NDArray[np.int64]]:
    """Return what is seen about some object (6, C, C), true masks (T, C, C), and whose they are."""
    # As at the first look, or as when looking closer; other cameras have other pixels.
    full = images.side
    side = min(round(rng.choice([full // 2, full]) * rng.uniform(*_SIZES)), full)
    ids, hidden = images.shown(index, side), images.hidden[index]
    middle = np.argwhere(ids > 0)
    centre = middle[rng.integers(len(middle))] if len(middle) else np.array([len(ids) // 2] * 2)
    corner = centre - _CROP // 2 + rng.integers(-16, 17, 2)
    top, left = np.clip(corner, 0, len(ids) - _CROP).tolist()
    where = slice(top, top + _CROP), slice(left, left + _CROP)
    visible = np.bincount(ids[where].ravel(), minlength=len(hidden) + 1)[1 : len(hidden) + 1]
    places = np.flatnonzero(visible >= _LEAST)
    own = images.objects[index]
    drawn, masks = [], []
    weight = 0.3 + (hidden[places] >= 0.1) + (hidden[places] >= 0.5)
    missing = int(rng.random() < 0.35)
    if len(places):
        size = targets - missing
        chosen = rng.choice(places, min(size, len(places)), False, weight / weight.sum())
        chosen = np.concatenate([chosen, rng.choice(places, size - len(chosen))])
        masks = [ids[where] == place + 1 for place in chosen]
        drawn = [int(own[place]) for place in chosen]
    # Of what is not there, nothing is to be found.
    others = np.setdiff1d(np.arange(objects), own)
    for number in rng.choice(others, targets - len(drawn)):
        masks.append(np.zeros((_CROP, _CROP), np.bool_))
        drawn.append(int(number))
    turn = int(rng.integers(4))
    rgb, depth, camera = images.seen(index, side)
    near = replace(camera, width=_CROP, height=_CROP, cx=camera.cx - left, cy=camera.cy - top)
    crop = np.rot90(image_channels(rgb[where], depth[where], near), turn, (1, 2))
    return crop.copy(), np.rot90(np.stack(masks), turn, (1, 2)).copy(), np.array(drawn, np.int64)


def _views(
    references: tuple[Tensor, Tensor, Tensor],
    numbers: NDArray[np.int64],
    views: int,
    rng: np.random.Generator,
) -> Tensor:
    """Return some views of objects (P, V, 6, S, S), turned and in other light."""
    every = references[0].shape[1]
    which = np.stack([rng.permutation(every)[:views] for _ in numbers])
    rgb, mask, width = (part[numbers[:, None], which] for part in references)
    shape = (len(numbers), views)
    known = torch.from_numpy(rng.random((len(numbers), 1)) > 0.15)
    width = width * torch.from_numpy(np.exp(rng.normal(0, 0.04, shape)).astype(np.float32)) * known
    seen = reference_channels(rgb, mask, width)
    balance = np.exp(rng.normal(0, 0.05, (len(numbers), 1, 3)))
    light = rng.uniform(0.75, 1.25, (len(numbers), 1, 1)) * balance
    gain = torch.from_numpy(light.astype(np.float32))[..., None, None]
    inside = seen[:, :, 3:4]
    seen[:, :, :3] = ((seen[:, :, :3] + 0.5) * gain - 0.5) * inside
    turns = torch.from_numpy(rng.integers(4, size=shape))
    for turn in (1, 2, 3):
        seen[turns == turn] = torch.rot90(seen[turns == turn], turn, (2, 3))
    return seen
