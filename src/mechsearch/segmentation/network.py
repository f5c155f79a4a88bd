"""The segmentation network: pixels of an RGB-D image held against reference views of the target."""

import copy
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from mechsearch.camera import Camera
from mechsearch.files.tensors import Archive, fill, load_archive, save_archive
from mechsearch.observe.masks import CHANNELS, logits_by, mask_of
from mechsearch.segmentation.layers import (
    COLOUR_CHANNELS,
    Convolution,
    Residual,
    asked_alike,
    colours_of,
    doubled,
)
from mechsearch.segmentation.reference import FULL, LOOKS, References
from mechsearch.types import Array, MechSearchError

_KIND = "mechsearch segmentation network of two looks"

_SHIPPED = Path(__file__).with_name("segmentation.safetensors")

REFERENCE_CHANNELS = 6
"""Of what is seen of a reference view; see `reference_channels`."""

_WIDTH = 0.1
"""What becomes 0 of a view's width [m]."""

_PARTS = 3
"""Rows and columns of the parts of a view whose mean colours are compared."""

_HEADS, _KEYS = 4, 16
"""Of attention, and numbers of a key."""


def reference_channels(rgb: Tensor, mask: Tensor, width: Tensor) -> Tensor:
    """Return what the network sees of reference views (..., 6, S, S).

    Args:
        rgb: Colours (..., S, S, 3) uint8.
        mask: Where the object is (..., S, S) bool.
        width: Of what they show (...,) [m]; 0 where it is not known.
    """
    inside = mask.float().unsqueeze(-3)
    colours = (rgb.float() / 255 - 0.5).movedim(-1, -3) * inside
    known = (width > 0).float()
    size = torch.log(torch.where(width > 0, width, _WIDTH) / _WIDTH) * known
    scalars = torch.stack([size, known], dim=-1)[..., None, None].expand(
        *width.shape, 2, *mask.shape[-2:]
    )
    return torch.cat([colours, inside, scalars], dim=-3)


class SegmentationNetwork(nn.Module):
    """Encodes an image once; then, for each target, attends to its views and decodes a mask."""

    def __init__(self) -> None:
        """Initialise weights at random."""
        super().__init__()
        self.fine = nn.Sequential(Convolution(CHANNELS, 16), Convolution(16, 8))
        self.down1 = nn.Sequential(Convolution(CHANNELS, 24, 5, 2), Residual(24))
        self.down2 = nn.Sequential(Convolution(24, 48, stride=2), Residual(48), Residual(48))
        self.down3 = nn.Sequential(Convolution(48, 80, stride=2), Residual(80), Residual(80))
        self.down4 = nn.Sequential(
            Convolution(80, 112, stride=2), Residual(112), Convolution(112, 80, 1)
        )
        self.up3 = nn.Sequential(Convolution(80, 80), Convolution(80, 48, 1))
        self.up2 = Convolution(48, 48)

        size = _HEADS * _KEYS
        self.views = nn.Sequential(
            Convolution(REFERENCE_CHANNELS, 24, stride=2), Convolution(24, 48, stride=2),
            Convolution(48, 64, stride=2), Residual(64),
        )  # fmt: skip
        self.keys, self.values = nn.Linear(128, size), nn.Linear(128, size)
        self.nothing = nn.Parameter(0.1 * torch.randn(2, _HEADS, 1, _KEYS))
        self.queries = nn.Conv2d(48, size, 1)
        self.alike, self.own = nn.Conv2d(48, 32, 1), nn.Linear(64, 32)

        # Of image and views alike, so that equal colours are alike from the beginning.
        self.colour = nn.Sequential(
            Convolution(COLOUR_CHANNELS, 24, stride=2), nn.Conv2d(24, 16, 1)
        )
        self.join = Convolution(48 + size + 4, 64, 1)
        self.film = nn.Linear(64, 128)
        self.mix = Convolution(64, 48)
        self.around = nn.Sequential(Convolution(48, 64, stride=2), Residual(64))
        self.whole, self.back = nn.Linear(128, 64), Convolution(64, 48, 1)
        self.near = nn.Sequential(Convolution(48, 32), Convolution(32, 16, 1))
        self.detail = nn.Sequential(Convolution(16 + 24 + 2, 16), Convolution(16, 16))
        self.mask = nn.Conv2d(16, 4 + 8, 3, padding=1)
        # Most pixels show something else.
        with torch.no_grad():
            self.mask.bias.copy_(torch.tensor([-4.0] * 4 + [0.0] * 8))  # type: ignore[union-attr]

    def raise_bound(self, logit: float) -> None:
        """Have all logits be less by so much, and masks be smaller."""
        with torch.no_grad():
            self.mask.bias[:4] -= logit  # type: ignore[index]

    def encode(self, images: Tensor) -> list[Tensor]:
        """Return features of images (B, 6, H, W), H and W being multiples of 16."""
        images = images.contiguous(memory_format=torch.channels_last)
        fine, one = self.fine(images), self.down1(images)
        two = self.down2(one)
        three = self.down3(two)
        three = three + doubled(self.down4(three))
        colour = self.colour(colours_of(images))
        return [fine, one, self.up2(two + doubled(self.up3(three))), colour]

    def look(self, references: Tensor) -> list[Tensor]:
        """Return features of targets by their views (P, V, 6, S, S).

        Keys and values are (P, heads, T, 16), with an additive mask (P, 1, 1, T) of the tokens
        beside the object; the first token is of nothing. Views (P, V, 32) are of length 1; then
        come the whole (P, 64), and colours (P, K, 16) with an additive mask (P, K, 1).
        """
        count, views = references.shape[:2]
        flat = references.flatten(0, 1).contiguous(memory_format=torch.channels_last)
        seen = self.views(flat)
        inside = (functional.adaptive_max_pool2d(flat[:, 3:4], seen.shape[-2:]) > 0).to(seen.dtype)
        mean = (seen * inside).sum((2, 3)) / inside.sum((2, 3)).clamp(min=1)
        tokens = seen.flatten(2).transpose(1, 2)
        tokens = torch.cat([tokens, mean[:, None].expand_as(tokens)], dim=2)
        tokens = tokens.reshape(count, -1, 128)
        keys, values = (
            torch.cat([
                nothing.expand(count, -1, -1, -1).to(seen.dtype),
                linear(tokens).reshape(count, -1, _HEADS, _KEYS).transpose(1, 2),
            ], dim=2)
            for linear, nothing in ((self.keys, self.nothing[0]), (self.values, self.nothing[1]))
        )  # fmt: skip
        beside = functional.pad((inside.reshape(count, 1, 1, -1) - 1) * 1e4, (1, 0))
        each = functional.normalize(self.own(mean), dim=1).reshape(count, views, -1)
        # Mean colours of a few parts of each view.
        within = functional.avg_pool2d(flat[:, 3:4], 2)
        colour = self.colour(colours_of(flat)) * within
        share = functional.adaptive_avg_pool2d(within, _PARTS)
        colour = functional.adaptive_avg_pool2d(colour, _PARTS) / share.clamp(min=0.05)
        missing = (share.reshape(count, -1, 1) < 0.05) * -1e4
        colour = colour.flatten(2).transpose(1, 2).reshape(count, -1, 16)
        whole = mean.reshape(count, views, -1).mean(1)
        return [keys, values, beside, each, whole, colour, missing]

    def decode(self, features: list[Tensor], target: list[Tensor], image: Tensor) -> Tensor:
        """Return logits (P, H, W) of the targets' masks.

        Args:
            features: Of images, from `encode`.
            target: Of P targets, from `look`.
            image: Which image each target is looked for on (P,).
        """
        fine, one, two, colour = (f[image] for f in features)
        keys, values, beside, each, whole, colours, missing = target
        height, width = two.shape[-2:]
        query = self.queries(features[2])[image].reshape(len(image), _HEADS, _KEYS, -1)
        attended = functional.scaled_dot_product_attention(
            query.transpose(2, 3).contiguous(),
            keys,
            values,
            beside.expand(-1, -1, height * width, -1),
        )
        embedded = functional.normalize(self.alike(features[2]), dim=1)[image].flatten(2)
        alike = each.to(embedded.dtype) @ embedded
        found = torch.cat([
            attended.transpose(2, 3).flatten(1, 2), alike.amax(1, True), alike.mean(1, True)
        ], dim=1)  # fmt: skip
        near = colours.to(colour.dtype) @ colour.flatten(2) + missing.to(colour.dtype)
        painted = torch.stack([near.amax(1), near.logsumexp(1)], dim=1)
        painted = painted.reshape(len(image), 2, *colour.shape[-2:])
        coarse = functional.avg_pool2d(painted, 2)
        x = self.join(torch.cat([two, found.reshape(len(image), -1, height, width), coarse], dim=1))
        scale, shift = self.film(whole)[:, :, None, None].chunk(2, dim=1)
        x = self.mix(
            torch.relu(x * (1 + scale) + shift).contiguous(memory_format=torch.channels_last)
        )
        y = self.around(x)
        pooled = torch.cat([y.mean((2, 3)), y.amax((2, 3))], dim=1)
        y = y + self.whole(pooled)[:, :, None, None].to(y.dtype)
        x = self.near(x + doubled(self.back(y)))
        x = self.mask(self.detail(torch.cat([doubled(x), one, painted.to(one.dtype)], dim=1)))
        logits: Tensor = functional.pixel_shuffle(x[:, :4].contiguous(), 2)[:, 0]
        return logits.float() + (doubled(x[:, 4:]) * fine).sum(1).float()


class Finding(nn.Module):
    """A network that has been told what to find, for export."""

    def __init__(self, network: SegmentationNetwork, target: Sequence[Tensor]) -> None:
        """Take features of one target, from `SegmentationNetwork.look`."""
        super().__init__()
        self._network = network
        for number, feature in enumerate(target):
            self.register_buffer(f"feature{number}", feature.clone())

    def forward(self, image: Tensor) -> Tensor:
        """Return logits (1, H, W) on an image (1, 6, H, W)."""
        features = self._network.encode(image)
        first = torch.zeros(1, dtype=torch.long)
        return self._network.decode(features, list(self.buffers(recurse=False)), first)


class NetworkSegmenter:
    """Finds an object by a network; a `Segmenter`."""

    def __init__(self, network: SegmentationNetwork, confidence: Sequence[float]) -> None:
        """Take a network, and the weights (3,) of `mask_features` and 1 in its confidence."""
        self._network = copy.deepcopy(network).eval().requires_grad_(False)
        for module in self._network.modules():
            if isinstance(module, Convolution):
                module.fold()
        self._weights = tuple(confidence)
        self._target: list[Tensor] | None = None

    def look_for(self, references: References) -> None:
        """Take the views of what is to be found; see `Segmenter`."""
        arrays = (references.rgb, references.mask, references.width)
        views = reference_channels(*(torch.from_numpy(array) for array in arrays))
        with asked_alike():
            self._target = self._network.look(views[None])

    def to_export(self, references: References) -> tuple[Finding, tuple[float, ...]]:
        """Return what finds one object on channels of an image, and weights of its confidence."""
        self.look_for(references)
        assert self._target is not None
        return Finding(self._network, self._target), self._weights

    def segment(self, rgb: Array, depth: Array, camera: Camera) -> tuple[Array, float]:
        """Return the target's mask and its confidence; see `Segmenter`.

        Raises:
            MechSearchError: If it has not been told what to look for.
        """
        return mask_of(self.logits(rgb, depth, camera), self._weights, camera)

    def logits(self, rgb: Array, depth: Array, camera: Camera) -> Array:
        """Return the logits of a mask; see `masks.logits_by`."""
        if self._target is None:
            raise MechSearchError("a segmenter without reference views; call look_for first")
        return logits_by(self._found, LOOKS, FULL, rgb, depth, camera)

    def _found(self, seen: Array) -> Array:
        assert self._target is not None
        image = torch.zeros(1, dtype=torch.long)
        with asked_alike():
            features = self._network.encode(torch.from_numpy(seen)[None])
            return np.asarray(self._network.decode(features, self._target, image)[0].numpy())


def network_segmenter(path: Path | None = None) -> NetworkSegmenter:
    """Return the segmenter that a network is; None takes the one that comes with the package."""
    return NetworkSegmenter(*load_segmentation_network(path))


def load_segmentation_network(
    path: Path | None = None,
) -> tuple[SegmentationNetwork, tuple[float, ...]]:
    """Return a network, and the weights (3,) of `mask_features` and 1 in its confidence.

    Args:
        path: Its file; None takes the shipped one.

    Raises:
        MechSearchError: If the file is missing, damaged or of another network.
    """
    archive = load_archive(path or _SHIPPED, _KIND)
    network = SegmentationNetwork()
    fill(network, archive.tensors)
    network = network.to(memory_format=torch.channels_last)
    return network.eval().requires_grad_(False), tuple(archive.meta["confidence"])


def segmentation_card(path: Path | None = None) -> dict[str, Any]:
    """Return what is known of a network's training; see `load_segmentation_network`."""
    meta = load_archive(path or _SHIPPED, _KIND).meta
    return {name: value for name, value in meta.items() if name != "confidence"}


def save_segmentation_network(
    path: Path,
    network: SegmentationNetwork,
    confidence: Sequence[float],
    meta: Mapping[str, object],
) -> None:
    """Write a network, its weights in 16 bits, whole or not at all.

    Args:
        path: The file.
        network: To write.
        confidence: Weights (3,) of `mask_features` and 1.
        meta: Plain JSON about it.
    """
    tensors = {k: v.half() if v.is_floating_point() else v for k, v in network.state_dict().items()}
    save_archive(path, Archive(_KIND, tensors, {**meta, "confidence": list(confidence)}))
