"""Rate grasps all over the target's visible region, and choose among them."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from mechsearch.camera import Camera
from mechsearch.grasp.candidates import ImageGrasp, alike, bin_angle
from mechsearch.grasp.grid import STRIDE, cells, depth_bins
from mechsearch.grasp.network import GraspNetwork
from mechsearch.grasp.view import GraspView
from mechsearch.types import Array, Floats

_CONSIDERED = 4096
"""Grasps among which those that are apart are looked for."""


@dataclass(frozen=True, eq=False)
class Ratings:
    """Qualities of all grasps whose centre is on the target.

    Attributes:
        quality: (D, 16, C): by depth, closing direction and cell.
        rows: Of the cells' centres (C,) [px].
        columns: Likewise (C,) [px].
        depths: Of the gripper (D,) [m].
        camera: Of the image.
    """

    quality: NDArray[np.float32]
    rows: Array
    columns: Array
    depths: Floats
    camera: Camera

    def best(self, count: int) -> list[ImageGrasp]:
        """Return the best grasps, best first; of equal ones, the first in depth, angle and cell."""
        return [self._grasp(i) for i in self._ranked(count)]

    def best_apart(self, count: int) -> list[ImageGrasp]:
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
        least = np.partition(flat, flat.size - count)[flat.size - count]
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
    """Rate the grasps on a target with at least one visible pixel.

    Only what the cells on the target can see is computed; the image goes on beyond its border as
    the surface that things stand on.
    """
    depths = depth_bins(float(view.depth[view.mask].min()), view.far)
    rows, columns = cells(view.mask)
    crop = view.around(rows.min(), rows.max(), columns.min(), columns.max())
    found = network.quality(
        torch.from_numpy(crop), torch.from_numpy(depths.astype(np.float32))
    ).numpy()
    i, j = (rows - rows.min()) // STRIDE, (columns - columns.min()) // STRIDE
    return Ratings(found[:, :, i, j], rows, columns, depths, view.camera)
