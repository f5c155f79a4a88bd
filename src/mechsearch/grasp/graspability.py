"""How graspable a target is: the mean quality of its best grasps (paper, section IV-C)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from mechsearch.camera import Camera
from mechsearch.grasp.grasp_scene import view_of_heap
from mechsearch.grasp.network import GraspNetwork
from mechsearch.grippers import (
    ANGLES,
    DEPTHS,
    STRIDE,
    GraspView,
    ImageGrasp,
    alike,
    bin_angle,
    cells,
)
from mechsearch.objects.model import ObjectModel
from mechsearch.sim import Workspace
from mechsearch.types import Array, Floats, MechSearchError

BEST = 10
"""Grasps that count (paper: 10)."""

_CONSIDERED = 4096
"""Grasps among which those that are apart are looked for."""


@dataclass(frozen=True, eq=False)
class Graspability:
    """How graspable one target is in one state.

    Attributes:
        score: Mean quality of the ten best grasps whose centre is on the visible target.
        diverse: The same over grasps at least 1 cm or 22.5 degrees apart: the ten best are
            neighbours of one peak.
        visible: Pixels of the target that the metric camera sees.
        lost: Whether the target has left the table.
        best: Pose (7,) of the best grasp in the world, or None where there is none.
    """

    score: float = 0.0
    diverse: float = 0.0
    visible: int = 0
    lost: bool = False
    best: Floats | None = None


@dataclass(frozen=True, eq=False)
class Ratings:
    """Qualities of all grasps whose centre is on the target.

    Attributes:
        quality: (D, 16, C): by depth, closing direction and cell; no cell where it is hidden.
        rows: Of the cells' centres (C,) [px].
        columns: Likewise (C,) [px].
        depths: Of the gripper (D,) [m].
        camera: Of the image.
        visible: Pixels of the target in it.
    """

    quality: NDArray[np.float32]
    rows: Array
    columns: Array
    depths: Floats
    camera: Camera
    visible: int

    @property
    def graspability(self) -> Graspability:
        """How graspable the target is; 0 where no pixel of it is visible."""
        if not self.visible:
            return Graspability()
        top, apart = self.best(), self.best_apart()
        mean, spread = (float(np.mean([g.quality for g in some])) for some in (top, apart))
        return Graspability(mean, spread, self.visible, best=top[0].pose(self.camera))

    def best(self, count: int = BEST) -> list[ImageGrasp]:
        """Return the best grasps, best first; of equal ones, the first in depth, angle and cell."""
        return [self._grasp(i) for i in self._ranked(count)]

    def best_apart(self, count: int = BEST) -> list[ImageGrasp]:
        """Return the best grasps of which no two are alike, best first; see `alike`."""
        ranked = self._ranked(_CONSIDERED)
        depth, angle, cell = np.unravel_index(ranked, self.quality.shape)
        z, turns = self.depths[depth], bin_angle(angle)
        x = (self.columns[cell] - self.camera.cx) / self.camera.fx
        y = (self.rows[cell] - self.camera.cy) / self.camera.fy
        centres = z[:, None] * np.stack([x, y, np.ones_like(x)], axis=1)
        left = np.ones(len(ranked), np.bool_)
        chosen: list[ImageGrasp] = []
        while left.any() and len(chosen) < count:
            first = int(np.argmax(left))
            chosen.append(self._grasp(ranked[first]))
            left &= ~alike(centres[first], float(turns[first]), centres, turns)
        return chosen

    def drawn(self, rng: np.random.Generator, count: int) -> list[ImageGrasp]:
        """Return grasps drawn uniformly from all of them."""
        return [self._grasp(i) for i in rng.integers(self.quality.size, size=count)]

    def _ranked(self, count: int) -> Array:
        """Return indices of the best grasps, best first."""
        flat = self.quality.ravel()
        count = min(count, flat.size)
        least = np.partition(flat, flat.size - count)[flat.size - count] if count else np.inf
        found = np.flatnonzero(flat >= least)
        return found[np.argsort(-flat[found], kind="stable")][:count]

    def _grasp(self, index: int) -> ImageGrasp:
        depth, angle, cell = np.unravel_index(index, self.quality.shape)
        return ImageGrasp(
            float(self.rows[cell]),
            float(self.columns[cell]),
            float(self.depths[depth]),
            float(bin_angle(int(angle))),
            float(self.quality[depth, angle, cell]),
        )


def rate(network: GraspNetwork, view: GraspView) -> Ratings:
    """Rate the grasps on a target; only what the cells on it can see is computed."""
    visible, depths = int(view.mask.sum()), view.gripper_depths
    if not visible:
        none = np.empty(0, np.intp)
        empty = np.empty((DEPTHS, ANGLES, 0), np.float32)
        return Ratings(empty, none, none, depths, view.camera, 0)
    rows, columns = cells(view.mask)
    crop = view.around(rows.min(), rows.max(), columns.min(), columns.max())
    found = network.quality(
        torch.from_numpy(crop), torch.from_numpy(depths.astype(np.float32))
    ).numpy()
    i, j = (rows - rows.min()) // STRIDE, (columns - columns.min()) // STRIDE
    return Ratings(found[:, :, i, j], rows, columns, depths, view.camera, visible)


def rate_target(
    network: GraspNetwork, models: Sequence[ObjectModel], poses: Array, target: int
) -> Ratings | None:
    """Rate the grasps on a target in a heap at rest, seen from above, the robot out of view.

    Args:
        network: Whose judgement it is.
        models: The objects; those that have left the table are left out.
        poses: Of theirs (N, 7).
        target: Its index; the result is None where it has left the table.

    Raises:
        MechSearchError: If poses and objects do not fit.
    """
    states = np.asarray(poses, np.float64)
    if states.shape != (len(models), 7) or not 0 <= target < len(models):
        raise MechSearchError(
            f"poses of shape {states.shape} and target {target} do not fit {len(models)} objects"
        )
    present, index = on_table(states, target)
    if index is None:
        return None
    return rate(network, view_of_heap([models[i] for i in present], states[present], index))


def graspability(
    network: GraspNetwork, models: Sequence[ObjectModel], poses: Array, target: int
) -> Graspability:
    """Return the graspability of a target in a heap at rest; see `rate_target`.

    A target that has left the table counts 0 and is flagged.
    """
    ratings = rate_target(network, models, poses, target)
    return Graspability(lost=True) if ratings is None else ratings.graspability


def ceiling(network: GraspNetwork, model: ObjectModel, pose: Array) -> Graspability:
    """Return the graspability of a target that lies as it does, all clutter removed."""
    return rate(network, view_of_heap([model], np.asarray(pose, np.float64)[None], 0)).graspability


def on_table(poses: Floats, target: int) -> tuple[list[int], int | None]:
    """Return which objects are on the table, and the target's place among them, or None."""
    present = np.flatnonzero(~Workspace().off_table(poses)).tolist()
    return present, present.index(target) if target in present else None
