"""A mask network as `mechsearch export segmenter` writes it, with the target's views in it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mechsearch.camera import Camera
from mechsearch.observe.masks import CHANNELS, check_seen, counted, logits_by, mask_of
from mechsearch.robot.network import Exported, Network, open_exported, tensors
from mechsearch.types import Array

KINDS = ("masks",)
"""Of exported segmenters."""


@dataclass(frozen=True)
class SegmenterDescription(Exported):
    """What stands beside the network, whose kind is "masks".

    Images may have any size; they are looked at as `masks.logits_by` does, closer at one of
    `image_size`. The network's input is what `masks.image_channels` returns.

    Attributes:
        looks: Sides of the network's input at either look [px].
        confidence: Weights (3,) of `masks.mask_of`.
        target: What it looks for: the views' file, or an object's name.
        views: How many views of it are in the network.
    """

    looks: Sequence[int]
    confidence: Sequence[float]
    target: str
    views: int


def described_masks() -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the inputs and outputs of a mask network; N is any multiple of 16."""
    unit = "colours less 0.5 (3), dm above the table, 1 in holes, log of a pixel's side by 5.4 mm"
    inputs = tensors({"image": ((1, CHANNELS, "N", "N"), "float32", unit)})
    return inputs, tensors({"logits": ((1, "N", "N"), "float32", "logit of the target")})


def open_segmenter(folder: str | Path) -> "ExportedSegmenter":
    """Return a segmenter that `mechsearch export segmenter` wrote; needs the `robot` extra.

    Raises:
        MechSearchError: If it is missing, damaged, or written for another version.
    """
    return ExportedSegmenter(*open_exported(Path(folder), "segmenter", SegmenterDescription, KINDS))


class ExportedSegmenter:
    """Finds the one object whose views it has."""

    def __init__(self, description: SegmenterDescription, network: Network) -> None:
        """Take an exported segmenter's parts; see `open_segmenter`."""
        self.description, self._network = description, network

    def segment(self, rgb: Array, depth: Array, camera: Camera) -> tuple[NDArray[np.bool_], float]:
        """Return where the target is seen (H, W), and how sure that is, in [0, 1].

        The mask is empty where that is less than `masks.LEAST_CONFIDENCE`, or it is tiny.

        Args:
            rgb: Colours (H, W, 3) uint8.
            depth: Along the optical axis (H, W) [m]; 0 or not finite in holes.
            camera: Where it is believed to be, in a world whose table is at height 0.

        Raises:
            MechSearchError: If colours, depth and camera differ in size, or the depth is holes
                alone.
        """
        check_seen(rgb, depth, camera)
        described = self.description
        looks, close = described.looks, described.image_size
        logits = logits_by(self._logits, looks, close, rgb, depth, camera)
        mask, confidence = mask_of(logits, self.description.confidence, camera)
        return counted(mask, confidence), confidence

    def _logits(self, seen: Array) -> Array:
        found: Array = self._network(image=seen[None])["logits"][0]
        return found
