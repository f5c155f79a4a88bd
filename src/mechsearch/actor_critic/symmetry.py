"""The eight symmetries of the workspace under the overhead camera: quarter turns and mirrors.

Under a camera that looks straight down on the centre of a square image (columns along x, rows
along -y), the task turned or mirrored is the same task. A symmetry here first swaps x and y or
not, then flips x or not and y or not.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import torch
from torch import Tensor

from mechsearch.types import MechSearchError

IMAGES = ("depth", "position_image", "rgb")
VECTORS = ("ee_position", "target_offset", "clutter_offsets", "action")
INVARIANT = ("clutter_mask", "target_label")


@dataclass(frozen=True)
class Symmetry:
    """One of the eight.

    Attributes:
        swap: Exchange x and y first.
        flip_x: Then mirror x.
        flip_y: Then mirror y.
    """

    swap: bool
    flip_x: bool
    flip_y: bool

    @property
    def mirrors(self) -> bool:
        """Whether it turns left into right, and not only the whole."""
        return (self.swap + self.flip_x + self.flip_y) % 2 == 1

    def of_vectors(self, vectors: Tensor) -> Tensor:
        """Return vectors (..., 3) in workspace axes, transformed."""
        x, y, z = vectors.unbind(-1)
        if self.swap:
            x, y = y, x
        return torch.stack([-x if self.flip_x else x, -y if self.flip_y else y, z], -1)

    def of_images(self, images: Tensor) -> Tensor:
        """Return images (..., H, H), their pixels moved; the values stay."""
        if self.swap:
            images = images.transpose(-1, -2)
        # Rows run along -y, so exchanging the axes mirrors at the other diagonal: both are flipped.
        mirrored = ((-1, self.flip_x), (-2, self.flip_y))
        flips = [axis for axis, flip in mirrored if flip != self.swap]
        return images.flip(flips) if flips else images

    def of(self, key: str, value: Tensor) -> Tensor:
        """Return a batch (B, ...) of one observation key, or of actions, transformed.

        Raises:
            MechSearchError: If it is not known how the key turns.
        """
        if key == "position_image":
            return self.of_vectors(self.of_images(value).movedim(1, -1)).movedim(-1, 1)
        if key in IMAGES:
            return self.of_images(value)
        if key in VECTORS:
            return self.of_vectors(value)
        if key in INVARIANT:
            return value
        known = ", ".join((*IMAGES, *VECTORS, *INVARIANT))
        raise MechSearchError(f"unknown how {key!r} turns; choose among {known}")


SYMMETRIES = tuple(Symmetry(*flags) for flags in product((False, True), repeat=3))
TURNS = tuple(symmetry for symmetry in SYMMETRIES if not symmetry.mirrors)
"""All eight; the first changes nothing."""


def transform(batch: Mapping[str, Tensor], symmetry: Symmetry) -> dict[str, Tensor]:
    """Return a batch of observations and actions by key, (B, ...), turned as a whole."""
    return {key: symmetry.of(key, value) for key, value in batch.items()}
