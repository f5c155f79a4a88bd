"""Plans grasps: proposals by geometry, rated by the gripper's grasp quality network."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mechsearch.geometry import rotation_from_quaternion
from mechsearch.grasp.grasp_view import GraspView, HeightMap, height_map
from mechsearch.grasp.proposals import antipodal, propose_jaws, propose_suction
from mechsearch.grasp.quality_network import QualityNetwork, aligned, load_quality_network
from mechsearch.sim import Gripper, SuctionCup, gripper_named
from mechsearch.types import Floats

PROPOSALS = 100
"""Grasps that are rated, at most."""

LEAST_VISIBLE = 16
"""Pixels of a target from which grasps are planned on it."""

_DRAWN = 10
"""Antipodal grasps asked for, where the first is wanted; more are tried, the more are asked for."""

_NEAR, _TURN = 0.01, float(np.cos(np.deg2rad(22.5)))
"""Grasps nearer than this [m] whose closing directions differ by less than this are alike."""


@dataclass(frozen=True, eq=False)
class RatedGrasps:
    """Grasps, the best first.

    Attributes:
        poses: Of the gripper's frame (K, 7); none where there is nothing to grasp.
        quality: Chance of success (K,) in [0, 1].
    """

    poses: Floats
    quality: Floats

    def __len__(self) -> int:
        return len(self.poses)

    def apart(self, count: int) -> "RatedGrasps":
        """Return the best of them of which no two are alike."""
        closing = rotation_from_quaternion(self.poses[:, 3:])[:, :, 0]
        left = np.ones(len(self), np.bool_)
        chosen: list[int] = []
        while left.any() and len(chosen) < count:
            first = int(np.argmax(left))
            chosen.append(first)
            near = np.linalg.norm(self.poses[:, :3] - self.poses[first, :3], axis=1) < _NEAR
            left &= ~(near & (np.abs(closing @ closing[first]) > _TURN))
            left[first] = False
        return RatedGrasps(self.poses[chosen], self.quality[chosen])


class GraspPlanner:
    """Plans the grasps of one gripper."""

    def __init__(self, name: str, path: Path | None = None) -> None:
        """Load a gripper's network.

        Args:
            name: Of the gripper.
            path: File of its network; None takes the shipped one.

        Raises:
            MechSearchError: If there is no such gripper, or the file is missing, damaged, or of
                another gripper or version.
        """
        self.gripper = gripper_named(name)
        self.network = load_quality_network(name, path)

    def plan(
        self, view: GraspView, rng: np.random.Generator, count: int = PROPOSALS
    ) -> RatedGrasps:
        """Return grasps of the target in a view, the best first.

        Args:
            view: From a camera whose world has the table at height 0.
            rng: Draws the proposals.
            count: Of proposals, at most.
        """
        if view.mask.sum() < LEAST_VISIBLE:
            return RatedGrasps(np.empty((0, 7)), np.empty(0))
        heights = height_map(view)
        return rate_grasps(self.network, heights, propose(heights, rng, count, self.gripper))

    def drawn(self, view: GraspView, rng: np.random.Generator) -> Floats | None:
        """Return the first random grasp (7,) that geometry alone promises, if there is one.

        Of jaws it is antipodal, the fingers free. It is what planned grasps are measured against.
        """
        if view.mask.sum() < LEAST_VISIBLE:
            return None
        if isinstance(self.gripper, Gripper):
            grasps = antipodal(view, rng, _DRAWN, self.gripper)
            return grasps[0].pose(view.camera) if grasps else None
        poses = propose(height_map(view), rng, 1, self.gripper)
        return poses[0] if len(poses) else None


def propose(
    heights: HeightMap, rng: np.random.Generator, count: int, gripper: Gripper | SuctionCup
) -> Floats:
    """Return at most `count` grasps (K, 7) of a gripper that geometry promises, in random order."""
    if not heights.target.any():
        return np.empty((0, 7))
    if isinstance(gripper, Gripper):
        return propose_jaws(heights, rng, count, gripper)
    return propose_suction(heights, rng, count, gripper.radius)


def rate_grasps(network: QualityNetwork, heights: HeightMap, poses: Floats) -> RatedGrasps:
    """Return grasps (K, 7), the best first."""
    if not len(poses):
        return RatedGrasps(poses, np.empty(0))
    quality = network.quality(aligned(heights, poses, network.grid))
    order = np.argsort(-quality, kind="stable")
    return RatedGrasps(poses[order], quality[order])
