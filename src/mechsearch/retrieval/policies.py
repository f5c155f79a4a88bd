"""Policies that retrieve without having learnt to: grasp; uncover and grasp; clear and grasp."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation

from mechsearch.env.decision import Decision
from mechsearch.env.task import TaskConfig
from mechsearch.evaluation.policies import RETRIEVE, make_policy
from mechsearch.grasp.grasp_view import GraspView, surroundings
from mechsearch.retrieval.grasper import TARGET, Candidate, Grasper
from mechsearch.types import (
    ACTOR_KEYS,
    BUDGET_KEYS,
    GRASP_KEYS,
    OCCLUSION_KEY,
    Array,
    Floats,
    Observation,
    select,
)

_BESIDE = 3
"""Pixels around the target within which another object's edge counts as touching it."""

_SAME = 0.02
"""Distance between the poses, as vectors (7,), up to which two removals are the same."""

_HIGHER = 0.004
"""By which an object at the target's edge is above it to hide a part of it [m]."""


class GraspOnly:
    """Grasps the target again and again, the best-rated way; what failed is rated lower."""

    goal = RETRIEVE
    keys: tuple[str, ...] = (*GRASP_KEYS, *BUDGET_KEYS)

    def __init__(self) -> None:
        """Begin without a gripper; see `equip`."""
        self.grasper = Grasper()

    def equip(self, grippers: tuple[str, ...]) -> None:
        """Take the names of the robot's grippers; see `Grasper.equip`."""
        self.grasper.equip(grippers)

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode; proposals come from `rng`."""
        self.grasper.reset(rng)

    def act(self, obs: Observation) -> Floats:
        """Return the vector (9,) of a decision."""
        return self.grasp(self.grasper.view(obs))

    def grasp(self, view: GraspView) -> Floats:
        """Return the vector (9,) of the most promising grasp of the target."""
        found = self.grasper.candidates(view) or [self.grasper.blind(view)]
        self.grasper.remember(view, found[0])
        return Decision.grasp(found[0].pose, found[0].gripper).vector()


class UncoverThenGrasp(GraspOnly):
    """Pushes by a shipped policy until the simulator says that the target is uncovered.

    A robot has no such word: that is this baseline's advantage.
    """

    keys: tuple[str, ...] = (*ACTOR_KEYS, *GRASP_KEYS, *BUDGET_KEYS, OCCLUSION_KEY)

    def __init__(
        self, pusher: str = "single", uncovered_at: float = TaskConfig.uncovered_at
    ) -> None:
        """Take who pushes, as for `make_policy`, and from which occlusion on it need not."""
        super().__init__()
        self._pusher, self._uncovered_at = make_policy(pusher), uncovered_at
        # Who pushes sees through one camera alone.
        self.camera = getattr(self._pusher, "camera", None)
        self.image_size = getattr(self._pusher, "image_size", None)

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode; pushes and proposals come from `rng`."""
        super().reset(rng)
        self._pusher.reset(rng)
        self._uncovered = False

    def act(self, obs: Observation) -> Floats:
        """Return the vector (9,) of a decision."""
        self._uncovered |= float(obs[OCCLUSION_KEY][0]) <= self._uncovered_at
        if self._uncovered or not obs["pushes_left"][0]:
            return super().act(obs)
        return Decision.push(self._pusher.act(select(obs, self._pusher.keys))).vector()


def uncover_then_grasp_dual() -> UncoverThenGrasp:
    """Return the baseline with the pushes that were learnt in dual heaps."""
    return UncoverThenGrasp("dual")


class ClearThenGrasp(GraspOnly):
    """Puts aside what lies on the target, the topmost first, and then grasps it.

    It is the classical heuristic of mechanical search.
    """

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode; proposals come from `rng`."""
        super().reset(rng)
        self._tried: list[Floats] = []

    def act(self, obs: Observation) -> Floats:
        """Return the vector (9,) of a decision."""
        if obs["removals_left"][0]:
            for occluder in occluders(obs["grasp_depth"], obs["segments"]):
                view = self.grasper.view(obs, occluder.segment)
                untried = [c for c in self.grasper.candidates(view, False) if self._is_new(c)]
                if untried:
                    self._tried.append(untried[0].pose)
                    return Decision.remove(untried[0].pose, untried[0].gripper).vector()
        return super().act(obs)

    def _is_new(self, candidate: Candidate) -> bool:
        away = [np.linalg.norm(candidate.pose - pose) for pose in self._tried]
        return bool(min(away, default=np.inf) > _SAME)


@dataclass(frozen=True)
class Occluder:
    """An object at the edge of the target's visible part, and above it there.

    Attributes:
        segment: Its number.
        height: Greatest height of its visible part over the table, up to a constant [m].
    """

    segment: int
    height: float


def occluders(depth: Array, segments: Array) -> list[Occluder]:
    """Return what seems to lie on the target, the topmost first.

    Args:
        depth: Of the fixed camera (H, W) [m].
        segments: What each pixel shows (H, W); the target is 1.
    """
    target = segments == TARGET
    if not target.any():
        return []
    part = surroundings(target, _BESIDE + 1)
    own, near, numbers = target[part], depth[part], segments[part]
    edge = binary_dilation(own, iterations=_BESIDE) & ~own
    found = []
    for number in np.unique(numbers[edge & (numbers > TARGET)]).tolist():
        beside = edge & (numbers == number)
        around = binary_dilation(beside, iterations=_BESIDE + 1) & own
        # The target's own depth there, from the pixels of it that are closest.
        if around.any() and near[beside].mean() < near[around].mean() - _HIGHER:
            found.append(Occluder(number, -float(depth[segments == number].min())))
    return sorted(found, key=lambda occluder: -occluder.height)
