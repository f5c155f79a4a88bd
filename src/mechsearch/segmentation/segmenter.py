"""Segmenters by name: what finds the target on an RGB-D image, the shipped network or one's own."""

from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from mechsearch.camera import Camera, preset
from mechsearch.entry_point import called, conforming, is_entry_point, load_entry_point
from mechsearch.objects.model import ObjectModel
from mechsearch.observe.masks import LEAST_CONFIDENCE, check_seen, counted
from mechsearch.segmentation.occlusion import (
    Occlusion,
    can_be_judged,
    make_estimator,
    patch_of,
    silhouette_areas,
)
from mechsearch.segmentation.reference import FULL, GRID, References, render_references
from mechsearch.types import Array, MechSearchError, real_array, shown

TRUE, SHIPPED = "true", "shipped"
"""Names of what the simulator knows, and of the shipped networks."""

NEVER = "never"
"""Name of what ends no episode."""

SURE, NEWEST = 0.8, 0.35
"""Average chance of being uncovered with which an episode is ended, and the share that the newest
look has in it."""

_NETWORK = "mechsearch.segmentation.network:network_segmenter"
_SUFFIX = ".safetensors"
_METHODS = ("look_for(references)", "segment(rgb, depth, camera)")


class Segmenter(Protocol):
    """Finds one object at a time, by views of it."""

    def look_for(self, references: References) -> None:
        """Take the views of what is to be found from now on."""

    def segment(self, rgb: Array, depth: Array, camera: Camera) -> tuple[Array, float]:
        """Return the target's mask on an image, and how sure it is.

        Args:
            rgb: Colours (H, W, 3) uint8.
            depth: Along the optical axis (H, W) [m]; 0 in holes.
            camera: Where it is believed to be, in a world whose table is at height 0.

        Returns:
            Where the target is seen (H, W) bool, and the chance in [0, 1] that more than half of
            the mask is on it.
        """


def check_segmenter(name: str) -> str:
    """Return the name of a segmenter.

    Raises:
        MechSearchError: If it can be none.
    """
    if name not in (TRUE, SHIPPED) and not _is_file(name) and not is_entry_point(name):
        raise MechSearchError(
            f"unknown segmenter {name!r}; choose {TRUE}, {SHIPPED}, a network's file "
            f"({_SUFFIX}), or package.module:factory"
        )
    return name


def make_segmenter(name: str) -> Segmenter:
    """Return a segmenter.

    Args:
        name: "shipped", a network's file (.safetensors), or `package.module:factory` of a function
            without arguments or a class.

    Raises:
        MechSearchError: If there is none of that name, or what is there is none.
    """
    if check_segmenter(name) == TRUE:
        raise MechSearchError(
            f"segmenter {TRUE!r} is a simulator's own mask; choose {SHIPPED}, a network's file, or "
            "package.module:factory"
        )
    # By name, because networks need PyTorch.
    place = _NETWORK if name == SHIPPED or _is_file(name) else name
    arguments = (Path(name),) if _is_file(name) else ()
    made: Any = called(load_entry_point(place, "segmenter"), "segmenter", place, *arguments)
    return cast("Segmenter", conforming(made, "segmenter", place, _METHODS))


def _is_file(name: str) -> bool:
    return name.endswith(_SUFFIX)


def visible_target(
    segmenter: Segmenter,
    rgb: Array,
    depth: Array,
    camera: Camera,
    least: float = LEAST_CONFIDENCE,
) -> tuple[NDArray[np.bool_], float]:
    """Return where a segmenter sees its target (H, W), and how sure it is.

    The mask is empty if that is less than `least`, or fewer than 4 are in it.

    Args:
        segmenter: Told what to look for.
        rgb: Colours (H, W, 3) uint8.
        depth: Along the optical axis (H, W) [m]; 0 or not finite in holes.
        camera: Where it is believed to be.
        least: Confidence in a mask.

    Raises:
        MechSearchError: If colours, depth and camera differ in size, the depth is holes alone, or
            the segmenter gives anything but a mask and a confidence.
    """
    check_seen(rgb, depth, camera)
    found = called(segmenter.segment, "segmenter", type(segmenter).__name__, rgb, depth, camera)
    expected = "a segmenter gives a mask as large as the image, and a confidence from 0 to 1"
    if not (isinstance(found, tuple) and len(found) == 2):
        raise MechSearchError(f"{expected}; got {shown(found)}")
    mask = real_array(found[0], expected)
    confidence = float(real_array(found[1], expected).reshape(-1)[0])
    if mask.shape != depth.shape or not 0.0 <= confidence <= 1.0:
        raise MechSearchError(f"{expected}; got a mask {mask.shape} and {confidence}")
    return counted(mask > 0.5, confidence, least), confidence


class TargetFinder:
    """Finds objects of a simulation as a robot would: by a segmenter, told what they look like.

    Attributes:
        camera: Of the images that it looks at, unless the task's camera is mounted.
    """

    def __init__(self, name: str, camera: str) -> None:
        """Make a segmenter.

        Args:
            name: See `make_segmenter`.
            camera: View of the images, a name for `camera.preset`.

        Raises:
            MechSearchError: If there is no such segmenter or view.
        """
        self.camera = preset(camera, FULL)
        self._segmenter = make_segmenter(name)
        self._target: ObjectModel | None = None

    def visible(
        self, target: ObjectModel, rgb: Array | None, depth: Array, camera: Camera, size: int = 0
    ) -> NDArray[np.bool_]:
        """Return where an object is seen (H, W), see `visible_target`, or at a `size` [px]."""
        if target is not self._target:
            references = render_references(target)
            called(
                self._segmenter.look_for, "segmenter", type(self._segmenter).__name__, references
            )
            self._target = target
        mask = visible_target(self._segmenter, np.asarray(rgb), depth, camera)[0]
        return resized(mask, size) if size else mask


def check_stop(name: str) -> str:
    """Return a name of what says that a target is uncovered.

    Raises:
        MechSearchError: If it can be none.
    """
    if name not in (TRUE, NEVER, SHIPPED) and not _is_file(name):
        raise MechSearchError(
            f"unknown stop {name!r}; choose {TRUE}, {NEVER}, {SHIPPED}, or a network's file "
            f"({_SUFFIX})"
        )
    return name


class Judge:
    """Says of objects of a simulation, as a robot would, whether they look uncovered.

    Attributes:
        camera: Of the images that it looks at.
    """

    def __init__(self, name: str, camera: str) -> None:
        """Read a network that estimates occlusion.

        Args:
            name: "shipped", or a network's file (.safetensors).
            camera: View of the images, a name for `camera.preset`.

        Raises:
            MechSearchError: If there is no such network or view.
        """
        self.camera = preset(camera, GRID)
        self._estimator = make_estimator(None if name == SHIPPED else Path(name))
        self._target: ObjectModel | None = None
        self._areas = np.zeros(3)

    def estimate(self, target: ObjectModel, depth: Array, mask: Array) -> Occlusion:
        """Return what is believed of an object on an image of `camera`.

        Of a tiny mask, or an image half of which is holes, nothing is, so that it is hidden.

        Args:
            target: The object.
            depth: Along the optical axis (H, W) [m]; 0 or not finite in holes.
            mask: Where it is seen (H, W) bool.
        """
        if target is not self._target:
            references = render_references(target)
            self._areas = silhouette_areas(references.mask, references.width)
            self._target = target
        if not can_be_judged(depth, mask):
            return Occlusion(1.0, 0.0)
        return self._estimator.estimate(*patch_of(depth, self.camera, mask, self._areas))

    @staticmethod
    def averaged(before: float, chance: float) -> float:
        """Return the running average of chances of being uncovered after one more look.

        What looks uncovered from the first on was not uncovered: looks count from one on that does
        not, and the average is less than 0 before.
        """
        if before < 0 and chance >= SURE:
            return before
        return (1 - NEWEST) * max(before, 0.0) + NEWEST * chance

    @staticmethod
    def ends(average: float) -> bool:
        """Return whether an average chance ends an episode."""
        return average >= SURE


def resized(mask: NDArray[np.bool_], size: int) -> NDArray[np.bool_]:
    """Return a mask on a square image of another size: where it covers half of a pixel or more."""
    grey = Image.fromarray(255 * mask.astype(np.uint8))
    return np.asarray(np.asarray(grey.resize((size, size), Image.Resampling.BOX)) >= 128)
