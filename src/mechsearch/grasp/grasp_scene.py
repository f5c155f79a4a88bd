"""What the fixed camera sees of objects, rendered."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mechsearch.grippers import METRIC_HEIGHT, GraspView, grasp_camera, metric_camera
from mechsearch.objects.model import ObjectModel
from mechsearch.render.renderer import Renderer
from mechsearch.types import Array


def grasp_renderer(models: Sequence[ObjectModel]) -> Renderer:
    """Return what renders these objects for grasping; to build it costs more than an image."""
    # An edge of the table would look like a drop that no gripper needs to heed.
    return Renderer(models, table_half=100.0)


@dataclass(frozen=True, eq=False)
class GraspScene:
    """What the fixed camera sees of a heap, the robot out of the way.

    Attributes:
        depth: Along the optical axis (512, 512) float32 [m].
        segments: What each pixel shows (512, 512) uint8: 0 the table, 1 the target, from 2 on the
            other visible objects, those with most pixels first.
        objects: Which object each segment is, from segment 1 on; no policy is told.
    """

    depth: NDArray[np.float32]
    segments: NDArray[np.uint8]
    objects: tuple[int, ...]


def see_heap(renderer: Renderer, poses: Array, target: int) -> GraspScene:
    """Return what the fixed camera sees of objects.

    Args:
        renderer: Of the objects, from `grasp_renderer`.
        poses: Of theirs (N, 7).
        target: Its index. It has segment 1 even where no pixel of it is visible.
    """
    frame = renderer.frame(grasp_camera(), poses)
    return GraspScene(frame.depth, *numbered(frame.ids, len(poses), target))


def numbered(ids: Array, count: int, target: int) -> tuple[NDArray[np.uint8], tuple[int, ...]]:
    """Return the segments of a `GraspScene`, and its objects.

    Args:
        ids: Which object each pixel shows (H, W); -1 where there is none.
        count: Of the objects.
        target: Index of the one that is segment 1 even where no pixel of it is visible.
    """
    pixels = np.bincount(ids[ids >= 0], minlength=count)
    # By size: their order in the heap would tell how it was made.
    shown = np.argsort(-pixels, kind="stable")[: np.count_nonzero(pixels)].tolist()
    objects = (target, *(index for index in shown if index != target))
    number = np.zeros(count + 1, np.uint8)
    number[list(objects)] = np.arange(1, len(objects) + 1)
    # The table's id is -1, so it reads the last number, which is 0.
    return number[ids], objects


def view_of_heap(models: Sequence[ObjectModel], poses: Array, target: int) -> GraspView:
    """Return the noise-free metric view of objects at rest, the robot out of sight.

    Args:
        models: The objects.
        poses: Of theirs (N, 7).
        target: Its index; the camera looks down on its centre.
    """
    camera = metric_camera(poses[target], models[target].radius)
    frame = grasp_renderer(models).frame(camera, poses)
    return GraspView(frame.depth, frame.modal(target), camera, METRIC_HEIGHT)
