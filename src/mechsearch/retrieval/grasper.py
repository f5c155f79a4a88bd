"""What grippers could grasp of what is seen, what failed before, and what lies on the target."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation

from mechsearch.env import reachable
from mechsearch.geometry import rotation_from_quaternion
from mechsearch.grasp.planner import GraspPlanner
from mechsearch.grippers import PROPOSALS, GraspView, segment_view, surroundings
from mechsearch.types import GRASP, Array, Floats, MechSearchError, Observation, Weighed

TARGET = 1
"""Segment of the target."""

_NEAR, _TURN = 0.012, float(np.cos(np.deg2rad(30.0)))
"""A grasp nearer than this [m] to one that failed, closing less than this off, is the same."""

_FAILED_AGAIN = 0.5
"""What the same grasp's chance is multiplied by."""

_FAILED_BEFORE = 0.6
"""What the odds of all grasps of a gripper are multiplied by for each of its grasps that failed:
whatever it failed for, such as the target's weight, the others share. Fitted to grasps that were
drawn from the better half on training heaps; once this is known, how near they were tells little.
"""

_UNSEEN = (0.0, 0.0, 0.03)
"""Where a target is looked for that was never visible (3,) [m]: in the middle of the heap."""

_BESIDE = 3
"""Pixels around the target within which another object's edge counts as touching it."""

_HIGHER = 0.004
"""By which an object at the target's edge is above it to hide a part of it [m]."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A grasp that could be made.

    Attributes:
        gripper: Number of the gripper.
        pose: Of its frame (7,).
        quality: Chance of success in [0, 1].
    """

    gripper: int
    pose: Floats
    quality: float


def weighed_grasps(candidates: Sequence[Candidate]) -> Weighed | None:
    """Return grasps of the target, the best first, as what was weighed; None where there are none.

    The best two dozen are enough to see.
    """
    best = candidates[:24]
    if not best:
        return None
    ways, values = tuple(each.pose for each in best), np.array([each.quality for each in best])
    return Weighed((GRASP,) * len(best), ways, values, 0, "chance to grasp the target now")


@dataclass(frozen=True, eq=False)
class _Failed:
    """A grasp of the target that failed: of which gripper, and how it lay.

    Attributes:
        gripper: Number of the gripper.
        offset: From the middle of the target's visible part (3,) [m].
        closing: Direction (3,).
    """

    gripper: int
    offset: Floats
    closing: Floats


class Grasper:
    """Plans with all grippers, and thinks less of what has failed before.

    A failed grasp is remembered by its place from the middle of the target's visible part, so that
    it moves along with the target, though it does not turn with it.
    """

    def __init__(self, proposals: int = PROPOSALS) -> None:
        """Begin without grippers; `proposals` are rated for each, at most."""
        self._proposals = proposals
        self._planners: tuple[GraspPlanner, ...] = ()
        self.grippers: tuple[str, ...] = ()
        self.reset(np.random.default_rng(0))

    def equip(self, grippers: Sequence[str]) -> None:
        """Take the names of the robot's grippers.

        Raises:
            MechSearchError: If there is no network for one of them.
        """
        if tuple(grippers) != self.grippers:
            self._planners = tuple(GraspPlanner(name) for name in grippers)
            self.grippers = tuple(grippers)

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode; proposals come from `rng`."""
        self._rng = rng
        self._failed: list[_Failed] = []
        self._last: Floats = np.array(_UNSEEN)

    def view(self, obs: Observation, segment: int = TARGET) -> GraspView:
        """Return the view of a segment; "grasp_depth" and "segments" are read."""
        return segment_view(obs["grasp_depth"], obs["segments"], segment)

    def candidates(self, view: GraspView, remembering: bool = True) -> list[Candidate]:
        """Return grasps of a view's target in reach of all grippers, the best first.

        Args:
            view: Of what is to be grasped.
            remembering: Whether it is the target, whose failed grasps count.

        Raises:
            MechSearchError: If no gripper is there yet.
        """
        if not self._planners:
            raise MechSearchError("a robot without a gripper; call equip before the first episode")
        if remembering:
            # Once it is hidden, this is where it was seen last.
            self.middle(view)
        found = []
        for number, planner in enumerate(self._planners):
            rated = planner.plan(view, self._rng, self._proposals)
            kept = reachable(rated.poses)
            poses, quality = rated.poses[kept], rated.quality[kept]
            failures = sum(failed.gripper == number for failed in self._failed)
            if remembering and failures and len(poses):
                odds = quality * _FAILED_BEFORE**failures
                quality = odds / (odds + 1 - quality)
                quality[self._remembered(view, number, poses)] *= _FAILED_AGAIN
            pairs = zip(poses, quality.tolist(), strict=True)
            found += [Candidate(number, pose, chance) for pose, chance in pairs]
        return sorted(found, key=lambda candidate: -candidate.quality)

    def remember(self, view: GraspView, candidate: Candidate) -> None:
        """Keep a grasp of the target that is about to be made, until the next episode.

        Who grasps again has failed: success ends the episode.
        """
        closing = rotation_from_quaternion(candidate.pose[3:])[:, 0]
        offset = candidate.pose[:3] - self.middle(view)
        self._failed.append(_Failed(candidate.gripper, offset, closing))

    def middle(self, view: GraspView) -> Floats:
        """Return the middle of the target's visible part (3,) [m]; of a hidden one, the last."""
        rows, columns = np.nonzero(view.mask)
        if len(rows):
            depth = np.median(view.depth[rows, columns])
            self._last = view.camera.points_at(columns.mean(), rows.mean(), depth)
        return self._last

    def blind(self, view: GraspView) -> Candidate:
        """Return a grasp from above, at any angle, where the target is seen or was seen last."""
        middle, yaw = self.middle(view), float(self._rng.uniform(0, np.pi))
        turn = [np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]
        return Candidate(0, np.array([*middle[:2], max(middle[2] - 0.02, 0.01), *turn]), 0.0)

    def _remembered(self, view: GraspView, gripper: int, poses: Floats) -> Array:
        """Return which grasps (K,) have failed before."""
        offset = poses[:, :3] - self.middle(view)
        closing = rotation_from_quaternion(poses[:, 3:])[:, :, 0]
        same = np.zeros(len(poses), np.bool_)
        for failed in self._failed:
            near = np.linalg.norm(offset - failed.offset, axis=1) < _NEAR
            alike = np.abs(closing @ failed.closing) > _TURN
            same |= near & alike & (failed.gripper == gripper)
        return same


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
