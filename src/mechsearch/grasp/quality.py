"""How graspable a target is: the mean quality of its best grasps (paper, section IV-C)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mechsearch.grasp.candidates import ImageGrasp
from mechsearch.grasp.network import GraspNetwork
from mechsearch.grasp.policy import rate
from mechsearch.grasp.retrieval import on_table
from mechsearch.grasp.view import GraspView, view_of_heap, view_of_target
from mechsearch.objects.model import ObjectModel
from mechsearch.types import Array, Floats, MechSearchError

BEST = 10
"""Grasps that count (paper: 10)."""


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

    score: float
    diverse: float
    visible: int
    lost: bool
    best: Floats | None


def graspability_of_view(network: GraspNetwork, view: GraspView) -> Graspability:
    """Return the graspability of a view's target; 0 where no pixel of it is visible."""
    visible = int(view.mask.sum())
    if not visible:
        return Graspability(0.0, 0.0, 0, False, None)
    ratings = rate(network, view)
    top, spread = ratings.best(BEST), ratings.best_apart(BEST)
    return Graspability(_mean(top), _mean(spread), visible, False, top[0].pose(view.camera))


def graspability(
    network: GraspNetwork,
    models: Sequence[ObjectModel],
    poses: Array,
    target: int,
) -> Graspability:
    """Return the graspability of a target in a heap at rest.

    It is measured from above, the robot out of view. A target that has left the table counts 0 and
    is flagged; other objects off the table are left out.

    Args:
        network: Whose judgement it is.
        models: The objects.
        poses: Of theirs (N, 7).
        target: Its index.

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
        return Graspability(0.0, 0.0, 0, True, None)
    view = view_of_heap([models[i] for i in present], states[present], index)
    return graspability_of_view(network, view)


def ceiling(network: GraspNetwork, model: ObjectModel, pose: Array) -> Graspability:
    """Return the graspability of a target that lies as it does, all clutter removed."""
    return graspability_of_view(network, view_of_target(model, np.asarray(pose, np.float64)))


def _mean(grasps: Sequence[ImageGrasp]) -> float:
    return float(np.mean([grasp.quality for grasp in grasps]))
