"""Grasps for a suction cup, proposed by geometry alone."""

import numpy as np

from mechsearch.grasp.height_map import HeightMap
from mechsearch.types import Floats

_TRIED = 1000
"""Visible places of the target that are tried."""

_ROUGH = 0.0025
"""Largest distance of the surface under the lip from its own plane [m]."""

_STEEPEST = np.deg2rad(45.0)
"""Greatest tilt of the approach [rad]."""


def propose_suction(
    heights: HeightMap, rng: np.random.Generator, count: int, radius: float
) -> Floats:
    """Return grasps (K, 7) where the cup's whole lip is on the visible target and nearly flat.

    Args:
        heights: Around the target.
        rng: Draws places.
        count: Of grasps, at most.
        radius: Of the lip [m].

    Returns:
        Poses of the gripper's frame in random order: the point that the lip touches, z axis along
        the normal of the plane through the surface under it; fewer or none where nothing is flat.
    """
    own = np.flatnonzero(heights.target)
    own = own[rng.permutation(len(own))[:_TRIED]]
    reach = int(np.ceil(radius / heights.cell))
    u, v = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    lip = u**2 + v**2 <= (radius / heights.cell + 0.25) ** 2
    u, v = u[lip], v[lip]
    # No cell under a lip is beyond the map: its margin is wider.
    cells = own[:, None] + u * heights.height.shape[1] + v
    whole = heights.target.ravel()[cells].all(axis=1)
    own, cells = own[whole], cells[whole]
    height = heights.height.ravel()[cells].astype(np.float64)
    middle = height.mean(axis=1)
    offset = height - middle[:, None]
    squares = float((u**2).sum()) * heights.cell
    slope = np.stack([offset @ u, offset @ v], axis=1) / squares
    plane = (slope[:, :1] * u + slope[:, 1:] * v) * heights.cell
    upright = 1.0 / np.sqrt(1.0 + (slope**2).sum(axis=1))
    rough = np.abs(offset - plane).max(axis=1, initial=0.0) * upright
    good = np.flatnonzero((rough <= _ROUGH) & (upright >= np.cos(_STEEPEST)))[:count]
    # The shortest turn that brings the z axis to the normal.
    normal = np.column_stack([-slope, np.ones(len(slope))])[good] * upright[good, None]
    turn = np.column_stack([1.0 + normal[:, 2], -normal[:, 1], normal[:, 0], np.zeros(len(good))])
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    return np.column_stack([heights.place(own[good]), middle[good], turn])
