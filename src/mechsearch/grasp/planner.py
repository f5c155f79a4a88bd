"""Grippers and the networks that rate their grasps."""

from pathlib import Path

import numpy as np

from mechsearch.grasp.proposals import antipodal
from mechsearch.grasp.quality_network import load_quality_network
from mechsearch.grippers import (
    LEAST_VISIBLE,
    PROPOSALS,
    GraspView,
    Gripper,
    RatedGrasps,
    gripper_named,
    height_map,
    plan_grasps,
    propose,
)
from mechsearch.types import Floats

_DRAWN = 10
"""Antipodal grasps asked for, where the first is wanted; more are tried, the more are asked for."""


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
        return plan_grasps(view, rng, count, self.gripper, self.network)

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
