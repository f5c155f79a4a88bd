"""From a robot's images to its next motion or grasp, and the refusals on the way."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from mechsearch.camera import Camera
from mechsearch.geometry import apply, cap_length, invert
from mechsearch.observe.observation import position_image, without_holes
from mechsearch.observe.reprojection import Reprojection, reproject
from mechsearch.robot.grasper import ExportedGrasper, GraspExpectation
from mechsearch.robot.limits import (
    GRASPING,
    MOVE,
    RETREAT,
    STOP,
    Limits,
    Motion,
    PlannedGrasp,
    Tool,
)
from mechsearch.robot.policy import Chooser
from mechsearch.robot.segmenter import ExportedSegmenter
from mechsearch.types import ACTION_LENGTH, Array, Floats, MechSearchError, Observation

_REACHED = 0.004
"""Distance from its goal at which a motion is over [m]."""

_TURNING = 5.0
"""Time that a tool may take to turn and to open for a grasp [s]."""

_LOST_LOOKS = {False: 5, True: 50}
"""Decisions in a row at which no target is seen, after which to stop, by whether a policy searches:
one that does may take an episode's 50 actions for it (paper, section IV)."""

_BLACK = 4
"""Mean of a colour image up to which it is black."""


@dataclass(frozen=True)
class CameraFrame:
    """What a camera sees, and where the target is in it.

    Attributes:
        depth: (H, W) [m], floating-point numbers; 0 or not finite in holes.
        mask: Visible pixels of the target (H, W) bool; None where nobody said, so that the
            controller's own segmenter looks, if it has one.
        camera: Its intrinsics, and as `world_from_camera` its pose in the robot's base frame.
        time: When it was taken [s].
        colour: (H, W, 3) uint8, or None.
    """

    depth: Array
    mask: Array | None
    camera: Camera
    time: float
    colour: Array | None = None


GRASP_FROM = 0.9
"""Quality from which on a grasp is made, unless another is asked for."""


class _RefusalError(Exception):
    """Why nothing may move, and whether to retreat."""


class Controller:
    """Asks a policy for motions, one after the other, and refuses what its limits forbid.

    With a grasper it grasps as soon as a grasp is rated high enough, in place of the next action.
    That grasp then stays what it asks for until it is reset.

    After a refusal it retreats, or stops, until it is reset. It holds no more than the limits that
    images need; the robot's driver has a `Guard`, which does not depend on it.

    Attributes:
        grasp_from: Quality from which on a grasp is made, in [0, 1]; 0 makes the best one.
        refusal: Why it has stopped; empty while it has not.
        seen: The last images that it decided on, in the policy's view; None before.
        mask: Of the target in the image that it was asked about last (H, W) bool, given or, for a
            decision, looked for; else None.
        goal: Of the present motion (3,) [m] in the base frame; None before.
    """

    def __init__(
        self,
        policy: Chooser,
        base_from_workspace: ArrayLike,
        limits: Limits,
        rng: np.random.Generator | None = None,
        segmenter: ExportedSegmenter | None = None,
        grasper: ExportedGrasper | None = None,
        grasp_from: float = GRASP_FROM,
    ) -> None:
        """Set a robot up.

        Args:
            policy: From `robot.policy.open_policy`.
            base_from_workspace: Where the workspace is: a rigid transform (4, 4). Its origin is on
                the table below the middle of the policy's view, its z axis points up.
            limits: In the robot's base frame.
            rng: Of the policy's candidates.
            segmenter: From `robot.segmenter.open_segmenter`: finds the target in images that come
                with colours and without a mask.
            grasper: From `robot.grasper.open_grasper`; without one it only pushes.
            grasp_from: See the attribute.

        Raises:
            MechSearchError: If the transform is not rigid or tips the table, or the box of the
                limits and the workspace have nothing in common, or `grasp_from` is no chance.
        """
        self.policy, self.limits, self.segmenter = policy, limits, segmenter
        self.grasp_from, self._grasper = grasp_from, grasper
        if not 0 <= grasp_from <= 1:
            raise MechSearchError(f"grasp_from is {grasp_from}; expected a chance from 0 to 1")
        self.view = policy.camera
        pose = np.asarray(base_from_workspace, np.float64)
        # A camera's pose is checked as any other.
        replace(self.view, world_from_camera=tuple(pose.ravel().tolist()))
        if pose[2, 2] < np.cos(np.deg2rad(5)):
            raise MechSearchError(
                f"base_from_workspace turns the table's z axis to {pose[:3, 2].tolist()}; expected "
                "it along the base's z axis, up to 5 degrees"
            )
        self._base_from_workspace, self._workspace_from_base = pose, invert(pose)
        self._lost_looks = limits.lost_looks or _LOST_LOOKS[policy.description.searches]
        self._low, self._high = (
            np.array(b) for b in (policy.description.low, policy.description.high)
        )
        corners = apply(pose, list(product(*zip(self._low, self._high, strict=True))))
        lowest, highest = corners.min(axis=0), corners.max(axis=0)
        if (highest < limits.low).any() or (lowest > limits.high).any():
            raise MechSearchError(
                f"the workspace lies from {lowest.round(3).tolist()} m to "
                f"{highest.round(3).tolist()} m in the base frame, outside the box from "
                f"{list(limits.low)} to {list(limits.high)}: is base_from_workspace right?"
            )
        self.reset(rng or np.random.default_rng())

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode, or go on after a refusal whose cause is gone."""
        self.policy.reset(rng)
        self._rng = rng
        self.refusal = ""
        self.seen: Reprojection | None = None
        self.goal: Floats | None = None
        self.mask: Array | None = None
        self._motion: Motion | None = None
        self._camera: Camera | None = None
        self._until, self._lost = 0.0, 0

    def step(self, frame: CameraFrame, tool: Tool, now: float, stop: bool = False) -> Motion:
        """Return what to do now; to be asked for each image, many times a motion.

        Args:
            frame: The newest image.
            tool: As it was measured last.
            now: [s], of the clock of both.
            stop: Whether somebody presses the stop.
        """
        self.mask = frame.mask
        if not self.refusal:
            try:
                self._check(frame, tool, now)
                if stop:
                    raise _RefusalError("the stop is pressed", False)
                return self._moved(frame, tool, now)
            except MechSearchError as error:
                self._refuse(str(error), tool, now, True)
            except _RefusalError as refusal:
                self._refuse(str(refusal.args[0]), tool, now, bool(refusal.args[1]))
        if stop:
            self._refuse("the stop is pressed", tool, now, False)
        assert self._motion is not None
        return replace(self._motion, time=now)

    def _check(self, frame: CameraFrame, tool: Tool, now: float) -> None:
        limits = self.limits
        unknown = now - tool.time > limits.watchdog or not np.isfinite(tool.position).all()
        if unknown:
            raise _RefusalError(f"the tool was measured {now - tool.time:.2f} s ago", False)
        if (beyond := limits.outside(tool.position)) > 0.01:
            raise _RefusalError(f"the tool is {beyond:.3f} m outside the box of the limits", False)
        if end := limits.ends_of_joints(tool):
            raise _RefusalError(end, False)
        if not -limits.image_age <= now - frame.time <= limits.image_age:
            raise _RefusalError(
                f"the image is {now - frame.time:.2f} s old; expected at most {limits.image_age}",
                True,
            )
        if (force := float(np.linalg.norm(tool.force))) > limits.force:
            raise _RefusalError(f"{force:.1f} N at the tool; expected at most {limits.force}", True)
        if frame.mask is None and self.segmenter is None:
            raise _RefusalError("no mask of the target came with the image", True)
        if frame.mask is None and frame.colour is None:
            raise _RefusalError("neither mask nor colours came with the image", True)
        if frame.colour is not None and float(np.mean(frame.colour)) <= _BLACK:
            raise _RefusalError("the colour image is black", True)
        first = self._camera = self._camera or frame.camera
        if replace(frame.camera, world_from_camera=first.world_from_camera) != first:
            raise _RefusalError("the camera's size or intrinsics have changed", True)
        between = invert(first.pose) @ frame.camera.pose
        shift = float(np.linalg.norm(between[:3, 3]))
        turn = float(np.rad2deg(np.arccos(np.clip((np.trace(between[:3, :3]) - 1) / 2, -1, 1))))
        if shift > limits.camera_shift or turn > limits.camera_turn:
            raise _RefusalError(
                f"the camera's pose has jumped by {shift:.3f} m and {turn:.1f} degrees", True
            )

    def _moved(self, frame: CameraFrame, tool: Tool, now: float) -> Motion:
        """Return the present motion, or the next one where that is over."""
        if self._motion is not None and now < self._until:
            reached = float(np.linalg.norm(self._motion.goal - tool.position)) <= _REACHED
            if reached and self._motion.kind == GRASPING:
                # The rest of it is the driver's, however long that takes.
                self._until = np.inf
            if not reached or self._until == np.inf:
                self._motion = replace(self._motion, time=now)
                return self._motion
        obs = self._observation(frame, tool)
        grasp, instead = self._grasp(frame)
        if grasp is not None:
            self._set_off(self.limits.way_to(grasp, tool.position), tool, now + _TURNING)
            self._motion = Motion(
                GRASPING, grasp.position, self.limits.speed, now, instead, grasp.quality,
                GraspExpectation(grasp.quality), grasp,
            )  # fmt: skip
            return self._motion
        choice = self.policy.choose(obs)
        step = cap_length(np.asarray(choice.action, np.float64) * ACTION_LENGTH, ACTION_LENGTH)
        inside = np.clip(obs["ee_position"] + step, self._low, self._high)
        goal = self.limits.clip(apply(self._base_from_workspace, inside))
        self._set_off([goal], tool, now)
        self._motion = Motion(
            MOVE, goal, self.limits.speed, now, choice.reason + instead, choice.confidence,
            choice.expects,
        )  # fmt: skip
        return self._motion

    def _set_off(self, way: Sequence[Floats], tool: Tool, now: float) -> None:
        """Begin a motion past some places (3,) to the last of them."""
        steps = np.diff([tool.position, *way], axis=0)
        length = float(np.linalg.norm(steps, axis=1).sum())
        self._until = now + 1.5 * length / self.limits.speed + 0.3
        self.goal = way[-1]

    def _grasp(self, frame: CameraFrame) -> tuple[PlannedGrasp | None, str]:
        """Return the best grasp in the box, and why; or none, and why there is none."""
        if self._grasper is None:
            return None, ""
        assert self.mask is not None
        found = self._grasper.plan(
            frame.depth, self.mask, frame.camera, self._rng, self._base_from_workspace
        )
        good = [grasp for grasp in found if grasp.quality >= self.grasp_from]
        for grasp in good:
            if not self.limits.beyond(grasp):
                return grasp, f"the best of {len(found)} grasps, rated {grasp.quality:.2f}"
        if good:
            return None, f"; {self.limits.beyond(good[0])}"
        if not found:
            return None, "; there is no place for a grasp"
        return None, f"; the best grasp is rated {found[0].quality:.2f}"

    def _observation(self, frame: CameraFrame, tool: Tool) -> Observation:
        """Return what the policy sees; count the looks that show no target."""
        pose = self._workspace_from_base @ frame.camera.pose
        camera = replace(frame.camera, world_from_camera=tuple(pose.ravel().tolist()))
        if frame.mask is None:
            assert self.segmenter is not None
            self.mask = self.segmenter.segment(np.asarray(frame.colour), frame.depth, camera)[0]
        self.seen = reproject(frame.depth, camera, self.view, self.mask, frame.colour, bins=True)
        mask = np.asarray(self.seen.mask)
        self._lost = 0 if mask.any() else self._lost + 1
        if self._lost >= self._lost_looks:
            raise _RefusalError(f"no target is seen in {self._lost} images in a row", True)
        tip = apply(self._workspace_from_base, tool.position)
        return {
            "depth": without_holes(self.seen.depth).astype(np.float16)[None],
            "position_image": position_image(mask, self.seen.depth, self.view, tip),
            "ee_position": tip.astype(np.float32),
        }

    def _refuse(self, reason: str, tool: Tool, now: float, retreats: bool) -> None:
        self.refusal = self.refusal or reason
        goal = self.limits.above(tool) if retreats else None
        kind = STOP if goal is None else RETREAT
        goal = np.array(tool.position, np.float64) if goal is None else goal
        self.goal, self._motion = goal, Motion(kind, goal, self.limits.speed, now, self.refusal)
