"""The lift test: descend, close, lift, shake, and see what is between the fingers.

A grasp is the pose (7,) of the gripper's frame in the world: its position is the grasp centre, its
x axis the closing direction, its z axis the direction against the approach.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import mujoco
import numpy as np

from mechsearch.geometry import (
    apply,
    quaternion_product,
    rotation_from_quaternion,
    transform_from_pose,
)
from mechsearch.grippers import Gripper
from mechsearch.objects.model import ObjectModel
from mechsearch.sim.scene import PhysicsConfig, Workspace, compile_scene, reset_data, warned
from mechsearch.sim.travel import Outlines
from mechsearch.types import Array, Floats, MechSearchError, Outcome

_SHORT, _STILL = 0.005, 0.004
"""Fingers so far from where they are told to be [m], and slower than this [m/s], have stalled."""


@dataclass(frozen=True)
class LiftConfig:
    """How the gripper moves.

    Attributes:
        physics: Numerical choices.
        descent_speed: [m/s].
        headroom: Between the fingers and what they may meet first, at the start [m].
        blocked_by: How far from its goal the descent may end [m].
        closing: Time to close [s].
        stalling: Time of the full squeeze once the fingers are stopped by something [s]; 0 lets
            them take the whole time to close.
        height: Of the lift [m].
        lifting: Time to lift [s].
        shake: Amplitude of the shake along the approach [m].
        frequency: Of the shake [Hz].
        shaking: Time to shake [s].
        risen: Share of the lift from which an object counts as lifted.
        gentle: Whether descent and shake begin and end at rest, as an arm's must.
    """

    physics: PhysicsConfig = field(default_factory=lambda: PhysicsConfig(time_step=0.004))
    descent_speed: float = 0.25
    headroom: float = 0.005
    blocked_by: float = 0.004
    closing: float = 0.22
    stalling: float = 0.0
    height: float = 0.2
    lifting: float = 0.5
    shake: float = 0.01
    frequency: float = 8.0
    shaking: float = 0.375
    risen: float = 0.4
    gentle: bool = False

    def steps(self, seconds: float) -> int:
        """Return how many time steps a duration takes."""
        return max(1, round(seconds / self.physics.time_step))


@dataclass(frozen=True)
class LiftFrame:
    """One instant of a film.

    Attributes:
        phase: "descend", "close", "lift" or "shake".
        poses: Of all objects (N, 7).
        gripper: Poses of palm and both fingers (3, 7).
    """

    phase: str
    poses: Floats
    gripper: Floats


class LiftWorld:
    """The objects of one heap and a gripper, compiled once for any number of grasps."""

    def __init__(
        self,
        models: Sequence[ObjectModel],
        gripper: Gripper | None = None,
        config: LiftConfig | None = None,
        workspace: Workspace | None = None,
    ) -> None:
        """Compile a scene of objects, in the order of all poses, a table and a gripper."""
        self.gripper = gripper or Gripper()
        self.config = config or LiftConfig()
        self.workspace = workspace or Workspace()
        self.count = len(models)
        self._outlines = Outlines([model.parts for model in models])
        self._model = compile_scene(
            models, self.workspace, None, (), self.config.physics, self.gripper
        )
        self._data = mujoco.MjData(self._model)
        names = ("gripper", "finger0", "finger1")
        body, geom = mujoco.mjtObj.mjOBJ_BODY, mujoco.mjtObj.mjOBJ_GEOM
        self._bodies = [mujoco.mj_name2id(self._model, body, name) for name in names]
        geoms = ("palm", "finger0", "finger1")
        self._geoms = [mujoco.mj_name2id(self._model, geom, name) for name in geoms]
        self._jaws = self._data.qpos[7 * self.count :]

    def lift(
        self,
        poses: Array,
        target: int,
        grasp: Array,
        friction: float | None = None,
        film: list[LiftFrame] | None = None,
    ) -> Outcome:
        """Try one grasp; the same arguments give the same outcome.

        Args:
            poses: Of all objects at rest (N, 7).
            target: Index of the object to lift.
            grasp: Pose (7,) of the gripper's frame.
            friction: Of the fingers; the gripper's own by default.
            film: Takes the frames, if there is one.

        Raises:
            MechSearchError: If the poses do not fit the objects, or the target is none of them.
        """
        states = np.asarray(poses, np.float64)
        if states.shape != (self.count, 7) or not 0 <= target < self.count:
            raise MechSearchError(
                f"poses of shape {states.shape} with target {target}; this scene has "
                f"{self.count} objects, so expected ({self.count}, 7) and 0 to {self.count - 1}"
            )
        self._reset(states, above_table(np.asarray(grasp, np.float64), self.gripper), friction)
        return LiftTest(self, states, target, self.height, film).run()

    @property
    def height(self) -> float:
        """Of the gripper over the grasp, along it [m]."""
        return float(self._jaws[0])

    def drive(self, height: float, closed: float | None = None) -> None:
        """Advance one step with the servos' goals; see `Rig`."""
        self._data.ctrl[0] = height
        if closed is not None:
            self._data.ctrl[1:] = closed
        mujoco.mj_step(self._model, self._data)

    def stalled(self, travel: float) -> bool:
        """Return whether the fingers stand still short of the travel that they are told [m]."""
        return has_stalled(travel, self._jaws[1:], self._data.qvel[-2:])

    def touched(self, finger: int) -> set[int]:
        """Return the objects that touch one finger."""
        return touching(self._model, self._data, self._geoms[1 + finger], self.count)

    def object_poses(self) -> Floats:
        """Return the poses (N, 7) of all objects."""
        return np.array(self._data.qpos[: 7 * self.count]).reshape(-1, 7)

    def unsound(self) -> bool:
        """Return whether the physics went wrong."""
        return is_unsound(self._data)

    def gripper_poses(self) -> Floats:
        """Return the poses (3, 7) of the rendered palm and fingers."""
        palm, *_ = self._bodies
        place = body_pose(self._data, palm)
        palm_pose = place.copy()
        palm_pose[:3] = apply(transform_from_pose(place), self.gripper.palm_place)
        fingers = [body_pose(self._data, body) for body in self._bodies[1:]]
        return np.stack([palm_pose, *fingers])

    def _reset(self, poses: Floats, grasp: Floats, friction: float | None) -> None:
        model, data = self._model, self._data
        reset_data(model, data)
        body = self._bodies[0]
        model.body_pos[body], model.body_quat[body] = grasp[:3], grasp[3:]
        model.geom_friction[self._geoms, 0] = (
            self.gripper.friction if friction is None else friction
        )
        data.qpos[: 7 * self.count] = poses.ravel()
        boxes = self._outlines.boxes(poses)
        self._jaws[0] = start_height(grasp, boxes, self.gripper.boxes, self.config.headroom)
        data.ctrl[:] = self._jaws
        # What rests may sleep after the first step, until something touches it.
        if self.config.physics.sleep_speed:
            data.tree_asleep[:] = -1


def start_height(
    grasp: Floats,
    boxes: tuple[Floats, Floats],
    parts: Sequence[tuple[Floats, Floats]],
    headroom: float,
) -> float:
    """Return how far above a grasp the open gripper cannot touch anything yet [m].

    Args:
        grasp: Pose (7,) of the gripper's frame.
        boxes: Lowest and highest corners (B, 3) [m] of what it may meet.
        parts: Half the sides and the centre (3,) of each part of the gripper [m].
        headroom: Left between the fingers and what they may meet first [m].
    """
    low, high = boxes
    rotation = rotation_from_quaternion(grasp[3:])
    needed = 0.0
    for half, place in parts:
        centre = grasp[:3] + rotation @ place
        extent = np.abs(rotation) @ half + 0.002
        # Along a tilted approach the body also moves sideways.
        extent[:2] += 0.1 * np.abs(rotation[:2, 2])
        over = (np.abs(centre[:2] - (low + high)[:, :2] / 2)
                < extent[:2] + (high - low)[:, :2] / 2).all(axis=1)  # fmt: skip
        top = high[over, 2].max(initial=0.0)
        needed = max(needed, top - (centre[2] - extent[2]))
    return needed / max(float(rotation[2, 2]), 0.5) + headroom


def above_table(grasp: Floats, gripper: Gripper) -> Floats:
    """Return the grasp, drawn back along its approach until no tip is too near the table."""
    rotation = rotation_from_quaternion(grasp[3:])
    half = gripper.finger_box
    side = gripper.finger_place[0] + half[0]
    corners = [[x, y, -gripper.reach] for x in (-side, side) for y in (-half[1], half[1])]
    lowest = grasp[2] + float((rotation @ np.array(corners).T)[2].min())
    raised = grasp.copy()
    if lowest < gripper.clearance:
        raised[:3] += rotation[:, 2] * (gripper.clearance - lowest) / max(rotation[2, 2], 0.1)
    return raised


@dataclass(frozen=True)
class Perturbation:
    """Spreads of what is uncertain; the values are Dex-Net's where it states them.

    Attributes:
        translation: Standard deviation along each axis [m].
        rotation: Standard deviation about each axis of the gripper [rad].
        friction: Mean sliding coefficient.
        friction_spread: Its standard deviation; draws are kept in [0.05, 1].
    """

    translation: float = 0.005
    rotation: float = float(np.deg2rad(3.0))
    friction: float = 0.5
    friction_spread: float = 0.1


def perturbed(grasp: Array, rng: np.random.Generator, spread: Perturbation) -> tuple[Floats, float]:
    """Return a grasp (7,) near the planned one, and the friction of its fingers."""
    pose = np.array(grasp, np.float64)
    pose[:3] += rotation_from_quaternion(pose[3:]) @ rng.normal(0.0, spread.translation, 3)
    half = rng.normal(0.0, spread.rotation, 3) / 2
    turn = np.array([1.0, *half])
    pose[3:] = quaternion_product(pose[3:], turn / np.linalg.norm(turn))
    friction = -1.0
    while not 0.05 <= friction <= 1.0:
        friction = float(rng.normal(spread.friction, spread.friction_spread))
    return pose, friction


class Rig(Protocol):
    """A gripper in a scene, as a lift test drives it; heights are over the grasp, along it [m]."""

    gripper: Gripper
    config: LiftConfig

    @property
    def height(self) -> float:
        """Where the gripper is."""

    def drive(self, height: float, closed: float | None = None) -> None:
        """Advance one step towards a height and a travel of each finger [m], if it is to change."""

    def stalled(self, travel: float) -> bool:
        """Return whether the fingers stand still short of the travel that they are told [m]."""

    def touched(self, finger: int) -> set[int]:
        """Return the objects that touch one finger."""

    def object_poses(self) -> Floats:
        """Return the poses (N, 7) of all objects."""

    def gripper_poses(self) -> Floats:
        """Return the poses (P, 7) of the gripper's rendered parts."""

    def unsound(self) -> bool:
        """Return whether the physics went wrong."""


class LiftTest:
    """One grasp under way: its phases, and what they come to."""

    def __init__(
        self, rig: Rig, poses: Floats, target: int, height: float, film: list[LiftFrame] | None
    ) -> None:
        """Take a gripper at a height [m] above its grasp, objects at rest at `poses` (N, 7)."""
        self._rig, self._poses, self._target, self._film = rig, poses, target, film
        self._config, self._gripper, self._start = rig.config, rig.gripper, height
        self._clock = 0

    def run(self) -> Outcome:
        """Execute the grasp."""
        rig, target = self._rig, self._target
        if not self._descend():
            return Outcome.BLOCKED
        self._close()
        squeezed = rig.touched(0) & rig.touched(1)
        if rig.unsound():
            return Outcome.FAILURE
        if not (rig.touched(0) | rig.touched(1)):
            return Outcome.MISSED
        if not self._lift():
            return Outcome.SLIPPED if target in squeezed else Outcome.MISSED
        lifted = self.lifted()
        if rig.unsound():
            return Outcome.FAILURE
        if target not in lifted:
            if lifted:
                return Outcome.WRONG_OBJECT
            return Outcome.SLIPPED if target in squeezed else Outcome.MISSED
        if len(lifted) > 1:
            return Outcome.TWO_OBJECTS
        self._shake()
        if rig.unsound():
            return Outcome.FAILURE
        held = rig.touched(0) & rig.touched(1)
        return Outcome.SUCCESS if held == {target} else Outcome.DROPPED

    def lifted(self) -> set[int]:
        """Return the objects that rose with the gripper."""
        rise = self._rig.object_poses()[:, 2] - self._poses[:, 2]
        return set(np.flatnonzero(rise > self._config.risen * self._config.height).tolist())

    def _descend(self) -> bool:
        """Go down; return whether the grasp was reached."""
        config, rig, start = self._config, self._rig, self._start
        steps = config.steps(start / config.descent_speed)
        for step in range(steps + config.steps(0.04)):
            share = min(1.0, (step + 1) / steps)
            goal = start * (1.0 - (eased(share) if config.gentle else share))
            self._step("descend", goal, 0.0)
            if rig.height - goal > 4 * config.blocked_by + 0.01:
                return False
        return bool(rig.height < config.blocked_by)

    def _close(self) -> None:
        config, closed = self._config, self._gripper.closed
        steps = config.steps(config.closing)
        for step in range(steps):
            travel = closed * min(1.0, 1.25 * (step + 1) / steps)
            self._step("close", 0.0, travel)
            if config.stalling and self._rig.stalled(travel):
                break
        else:
            return
        for _ in range(config.steps(config.stalling)):
            self._step("close", 0.0, closed)

    def _lift(self) -> bool:
        """Lift; return False as soon as the fingers hold nothing."""
        config, rig = self._config, self._rig
        steps = config.steps(config.lifting)
        for step in range(steps):
            share = (1 - np.cos(np.pi * (step + 1) / steps)) / 2
            self._step("lift", config.height * share)
            if step % 8 == 7 and not (rig.touched(0) | rig.touched(1)):
                return False
        return True

    def _shake(self) -> None:
        config, rig = self._config, self._rig
        for step in range(config.steps(config.shaking)):
            seconds = (step + 1) * config.physics.time_step
            sway = config.shake * np.sin(2 * np.pi * config.frequency * seconds)
            if config.gentle:
                sway *= min(1.0, config.frequency * min(seconds, config.shaking - seconds))
            self._step("shake", config.height + sway)
            if step % 8 == 7 and self._target not in rig.touched(0) | rig.touched(1):
                return

    def _step(self, phase: str, height: float, closed: float | None = None) -> None:
        self._rig.drive(height, closed)
        self._clock += 1
        if self._film is not None and self._clock % 5 == 0:
            poses = self._rig.object_poses()
            self._film.append(LiftFrame(phase, poses, self._rig.gripper_poses()))


def eased(share: float) -> float:
    """Return how much of a way is behind what goes from rest to rest, at a share of its time."""
    return share**3 * (10 - 15 * share + 6 * share**2)


def has_stalled(travel: float, fingers: Floats, speeds: Floats) -> bool:
    """Return whether fingers at (2,) [m] stand still, at (2,) [m/s], short of a travel [m]."""
    short = travel - float(fingers.max()) > _SHORT
    return short and float(np.abs(speeds).max()) < _STILL


def is_unsound(data: mujoco.MjData) -> bool:
    """Return whether the physics of a scene went wrong since `reset_data`."""
    finite = np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()
    return not finite or warned(data)


def body_pose(data: mujoco.MjData, body: int) -> Floats:
    """Return the pose (7,) of a body."""
    return np.array([*data.xpos[body], *data.xquat[body]])


def touching(model: mujoco.MjModel, data: mujoco.MjData, geom: int, count: int) -> set[int]:
    """Return which of `count` objects, the scene's first bodies, touch a geom."""
    pairs = data.contact.geom[: data.ncon]
    own = pairs == geom
    others = pairs[own[:, ::-1]]
    bodies = model.geom_bodyid[others]
    return {int(body) - 1 for body in bodies if 1 <= body <= count}
