"""Masks that a segmenter finds on images of heaps, held against the truth."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from time import process_time

import numpy as np
from numpy.typing import NDArray

from mechsearch.segmentation.images import Images, ImageSet
from mechsearch.segmentation.segmenter import Segmenter, visible_target
from mechsearch.types import Array, Floats, MechSearchError

PARTLY = (0.1, 0.9)
"""Share of a target that is hidden where its mask is judged."""

_LEAST = 32
"""Pixels that a target must show."""


@dataclass(frozen=True, eq=False)
class Found:
    """What was found of targets (n,), against the truth.

    Attributes:
        iou: Of mask and visible pixels.
        right: Whether more than half of the mask is on the target.
        hidden: Share of the target that others hide.
        pixels: That the target shows.
        confidence: In the mask.
        seconds: Of one processor that the segmenter took.
        heap: Seed of the heap.
        object: Number of the target among the references.
    """

    iou: Floats
    right: NDArray[np.bool_]
    hidden: Floats
    pixels: NDArray[np.int64]
    confidence: Floats
    seconds: Floats
    heap: NDArray[np.int64]
    object: NDArray[np.int64]

    def where(self, keep: Array) -> "Found":
        """Return some, by a mask (n,) or indices."""
        return Found(*(getattr(self, field.name)[keep] for field in fields(self)))

    @property
    def summary(self) -> dict[str, float]:
        """Means over targets: IoU where less and more than half is hidden, share of right masks."""
        less = self.hidden < 0.5
        return {
            "iou": float(self.iou[less].mean()) if less.any() else math.nan,
            "iou_hidden": float(self.iou[~less].mean()) if not less.all() else math.nan,
            "right": float(self.right.mean()),
        }

    @property
    def reliability(self) -> list[tuple[float, float, int]]:
        """Mean confidence, share of right masks and number of each fifth of the targets."""
        fifths = np.array_split(np.argsort(self.confidence, kind="stable"), 5)
        return [
            (float(self.confidence[own].mean()), float(self.right[own].mean()), len(own))
            for own in fifths
            if len(own)
        ]


def partly_hidden(images: Images, targets: bool = True) -> list[tuple[int, int]]:
    """Return objects on images that others hide partly, as numbers of image and place.

    Args:
        images: With the truth.
        targets: Whether to return each heap's own target alone.
    """
    found = []
    for index, (ids, hidden) in enumerate(zip(images.ids, images.hidden, strict=True)):
        pixels = np.bincount(ids.ravel(), minlength=len(hidden) + 1)[1 : len(hidden) + 1]
        fits = (pixels >= _LEAST) & (hidden >= PARTLY[0]) & (hidden <= PARTLY[1])
        places = images.target[index : index + 1] if targets else np.arange(len(hidden))
        found += [(index, int(place)) for place in places if place >= 0 and fits[place]]
    return found


def found_by(
    segmenter: Segmenter,
    seen: ImageSet,
    wanted: Sequence[tuple[int, int]],
    told: Callable[[int, int], object] = lambda *_: None,
) -> Found:
    """Return what a segmenter finds of objects on images.

    Args:
        segmenter: To judge.
        seen: Images with the truth.
        wanted: Image and place of each object, from `partly_hidden`.
        told: Told after each of them how many are done, and of how many.

    Raises:
        MechSearchError: If nothing is wanted, or the segmenter gives no masks.
    """
    if not wanted:
        raise MechSearchError(
            f"no target on {len(seen.images)} images is {PARTLY[0]:.0%} to {PARTLY[1]:.0%} hidden; "
            "expected at least one"
        )
    rows, images = [], seen.images
    for done, (index, place) in enumerate(wanted, start=1):
        number = int(images.objects[index, place])
        segmenter.look_for(seen.references[number])
        began = process_time()
        mask, confidence = visible_target(segmenter, *images.seen(index), least=0.0)
        seconds = process_time() - began
        truth = images.ids[index] == place + 1
        both = int((truth & mask).sum())
        rows.append((
            both / (truth | mask).sum(), both > 0.5 * mask.sum(), images.hidden[index, place],
            truth.sum(), confidence, seconds, images.heap[index], number,
        ))  # fmt: skip
        told(done, len(wanted))
    return Found(*(np.array(column) for column in zip(*rows, strict=True)))
