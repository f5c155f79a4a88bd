"""A heap and a robot that pushes with its closed jaws, grasps, holds, releases and puts aside.

All of it is one simulation in one time step. Where the heap lies still and nothing is near, the
robot travels exactly and nothing is simulated, as for pushes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from weakref import proxy

import mujoco
import numpy as np

from mechsearch.geometry import apply, rotation_from_quaternion, transform_from_pose
from mechsearch.grippers import AnyGripper, Gripper, SuctionCup
from mechsearch.objects.model import ObjectModel
from mechsearch.sim.gripper import (
    GRASPING_STIFFNESS,
    close_jaws,
    open_parts,
    stiffen,
)
from mechsearch.sim.lift import (
    LiftConfig,
    LiftFrame,
    LiftTest,
    above_table,
    body_pose,
    has_stalled,
    is_unsound,
    start_height,
    touching,
)
from mechsearch.sim.scene import PhysicsConfig, Workspace
from mechsearch.sim.suction import SuctionTest, seal_of
from mechsearch.sim.world import World
from mechsearch.types import Array, Floats, MechSearchError, Outcome

_PARKED = np.array([0.0, 0.0, 5.0])
_UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])

SQUEEZE = 0.08
"""Time for which the jaws squeeze what has stopped them before they lift it [s]."""

_RISE_SPEED = 0.25
"""At which a gripper leaves a heap upwards [m/s]."""


@dataclass(frozen=True)
class Attempt:
    """What became of a grasp.

    Attributes:
        outcome: Judged for the target.
        held: Objects that are in the gripper now, or hang on what is.
    """

    outcome: Outcome
    held: tuple[int, ...] = ()


class GripperWorld(World):
    """Objects on a table, and one or several travelling grippers of which the first pushes.

    Between pushes and grasps all grippers point down, the jaws are closed, and those that do not
    push are far above: a snapshot taken then has all that the next step depends on.
    """

    def __init__(
        self,
        models: Sequence[ObjectModel],
        grippers: Sequence[AnyGripper],
        workspace: Workspace | None = None,
        config: PhysicsConfig | None = None,
    ) -> None:
        """Compile a scene.

        Args:
            models: The objects, in the order of all poses.
            grippers: At least one.
            workspace: Table and bounds.
            config: Numerical choices.

        Raises:
            MechSearchError: If there is no gripper.
        """
        if not grippers:
            raise MechSearchError("a robot without a gripper; expected at least one")
        super().__init__(models, workspace, None, (), config, grippers)
        self._rigs = [
            _JawRig(self, models, index, gripper)
            if isinstance(gripper, Gripper)
            else _CupRig(self, models, index, gripper)
            for index, gripper in enumerate(grippers)
        ]
        self._held: _Rig | None = None
        self._lifted: tuple[int, ...] = ()
        self.grippers = tuple(grippers)

    def reset(self, poses: Array, pusher_position: Array | None = None) -> None:
        """Put all objects at rest at `poses` (N, 7), the pusher where it is told, jaws closed."""
        self._held, self._lifted = None, ()
        for rig in self._rigs:
            rig.restore()
        super().reset(poses, pusher_position)
        for rig in self._rigs:
            rig.park()
        self.place_pusher(_PARKED if pusher_position is None else pusher_position)

    def place_pusher(self, position: Array) -> None:
        """Put the pushing gripper, closed, at rest with its tips at a position (3,) [m]."""
        self._rigs[0].stand(np.asarray(position, np.float64))

    def attempt(
        self,
        target: int,
        pose: Array,
        gripper: int = 0,
        friction: float | None = None,
        film: list[LiftFrame] | None = None,
    ) -> Attempt:
        """Grasp, lift and shake, from wherever the robot is; it holds afterwards what came up.

        Args:
            target: Index of the object that is meant.
            pose: Of the gripper's frame (7,).
            gripper: Its number.
            friction: Of fingers or lip; the gripper's own by default.
            film: Takes the frames, if there is one.

        Raises:
            MechSearchError: If there is no such target or gripper, or it still holds something.
        """
        if not 0 <= target < self.count or not 0 <= gripper < len(self._rigs):
            raise MechSearchError(
                f"target {target} and gripper {gripper}; expected 0 to {self.count - 1} and 0 to "
                f"{len(self._rigs) - 1}"
            )
        if self._held is not None:
            raise MechSearchError("the gripper holds something; release or stow it first")
        self._wake()
        self._leave(self._rigs[0], film)
        self._rigs[0].park()
        self._rest(round(1.0 / self.config.time_step))
        rig = self._rigs[gripper]
        outcome, lifted = rig.attempt(self.poses, target, np.asarray(pose, np.float64),
                                      friction, film)  # fmt: skip
        self._held, self._lifted = rig, tuple(sorted(lifted))
        return Attempt(outcome, self._lifted)

    def release(self, film: list[LiftFrame] | None = None) -> None:
        """Put what is held back where it was, leave it upwards, and close the jaws."""
        rig = self._release_from()
        if self._lifted:
            rig.lower(film)
            rig.open(film)
            self._leave(rig, film)
        self._retire(rig)

    def stow(self, film: list[LiftFrame] | None = None) -> tuple[int, ...]:
        """Put what is held aside, into a tray that is no part of the scene; return what it was."""
        del film
        rig, stowed = self._release_from(), self._lifted
        for index in stowed:
            self.remove(index)
        self._retire(rig)
        return stowed

    def settle(self, seconds: float = 2.0) -> None:
        """Let the heap come to rest, the robot standing still, for at most so long [s]."""
        self._wake()
        self._rest(round(seconds / self.config.time_step))

    def try_grasp(
        self,
        poses: Array,
        target: int,
        pose: Array,
        gripper: int = 0,
        friction: float | None = None,
        film: list[LiftFrame] | None = None,
    ) -> Outcome:
        """Return what a grasp comes to from given poses (N, 7) at rest; see `attempt`.

        The state before is lost; the same arguments give the same outcome.

        Raises:
            MechSearchError: As `attempt`, or if the poses do not fit the objects.
        """
        states = np.asarray(poses, np.float64)
        if states.shape != (self.count, 7):
            raise MechSearchError(f"poses of shape {states.shape}; expected ({self.count}, 7)")
        self.reset(states)
        outcome = self.attempt(target, pose, gripper, friction, film).outcome
        self.reset(states)
        return outcome

    def gripper_poses(self, gripper: int = 0) -> Floats:
        """Return the poses (P, 7) of a gripper's rendered parts, `models()` of it."""
        mujoco.mj_kinematics(self._model, self._data)
        return self._rigs[gripper].gripper_poses()

    def _release_from(self) -> "_Rig":
        rig, self._held = self._held, None
        if rig is None:
            raise MechSearchError("the gripper holds nothing; attempt a grasp first")
        return rig

    def _retire(self, rig: "_Rig") -> None:
        """Bring a gripper back upright, and the pushing one to where pushes can begin."""
        away = self.workspace.clip(np.array([*rig.tip[:2], self.workspace.high]))
        self._lifted = ()
        rig.restore()
        for each in self._rigs:
            each.park()
        self.place_pusher(away)

    def _leave(self, rig: "_Rig", film: list[LiftFrame] | None) -> None:
        """Move a gripper straight up until nothing of the heap can touch it."""
        _, high = self._outlines.boxes(self._objects)
        on_table = high[high[:, 2] < 1.0, 2]
        way = float(on_table.max(initial=0.0)) + 0.01 - float(rig.tip[2])
        if way > 0:
            rig.climb(way, film)


class _Rig:
    """One travelling gripper of a world, and how it is driven; see `lift.Rig`."""

    def __init__(
        self, world: GripperWorld, models: Sequence[ObjectModel], index: int, gripper: AnyGripper
    ) -> None:
        # Not in a circle: the engine's memory must go as soon as its world does.
        self._world: GripperWorld = proxy(world)
        self._models, self._index = models, index
        self._model, self._data, self.count = world._model, world._data, world.count
        self.config = LiftConfig(physics=world.config)
        model = self._model
        joints = [model.joint(f"arm{index}{axis}").id for axis in "xyz"]
        self.tip: Floats = self._data.qpos[model.jnt_qposadr[joints[0]] :][:3]
        self._speed: Floats = self._data.qvel[model.jnt_dofadr[joints[0]] :][:3]
        servos = [model.actuator(f"arm{index}{axis}").id for axis in "xyz"]
        self._servos = servos
        self._set_point: Floats = self._data.act[model.actuator_actadr[servos[0]] :][:3]
        self._wrist = model.body(f"wrist{index}").id
        self._geoms = [
            geom for geom in range(model.ngeom)
            if model.body_rootid[model.geom_bodyid[geom]] == model.body(f"arm{index}").id
        ]  # fmt: skip
        self._pushing = [
            part[servos].copy()
            for part in (model.actuator_forcerange, model.actuator_gainprm, model.actuator_biasprm)
        ]
        self._base, self._axis = np.zeros(3), np.array([0.0, 0.0, 1.0])
        self._reach, self._friction = gripper.reach, gripper.friction
        self._press, self._pull = gripper.press, gripper.pull

    @property
    def height(self) -> float:
        """Of the gripper over its grasp, along it [m]."""
        return float((self.tip - self._base) @ self._axis)

    def object_poses(self) -> Floats:
        """Return the poses (N, 7) of all objects."""
        return self._world.poses

    def unsound(self) -> bool:
        """Return whether the physics went wrong."""
        return is_unsound(self._data)

    def stand(self, position: Floats) -> None:
        """Put it at rest somewhere where nothing is near."""
        self.tip[:] = position
        self._speed[:] = 0.0
        self._set_point[:] = position
        self._data.ctrl[self._servos] = 0.0

    def park(self) -> None:
        """Put it at rest where it is in nobody's way, closed."""
        self.let_go()
        self.stand(_PARKED * (1 + self._index))

    def let_go(self) -> None:
        """Hold nothing any more, at once."""

    def aim(self, grasp: Floats, height: float, friction: float | None) -> None:
        """Turn to a grasp (7,) and stand above it [m], where nothing is near."""
        model = self._model
        rotation = rotation_from_quaternion(grasp[3:])
        self._axis = rotation[:, 2]
        self._base = grasp[:3] - self._reach * self._axis
        model.body_quat[self._wrist] = grasp[3:]
        model.geom_friction[self._geoms, 0] = self._friction if friction is None else friction
        stiffen(model, self._servos, GRASPING_STIFFNESS)
        # An arm gives way to what presses on it from below, and is strong otherwise.
        model.actuator_forcerange[self._servos] = [-self._pull, self._pull]
        model.actuator_forcerange[self._servos[2], 0] = -self._press
        self.stand(self._base + height * self._axis)

    def restore(self) -> None:
        """Point down again, with the forces and the friction of pushing."""
        self._model.body_quat[self._wrist] = _UPRIGHT
        self._model.geom_friction[self._geoms, 0] = self._friction
        force, gain, bias = self._pushing
        self._model.actuator_forcerange[self._servos] = force
        self._model.actuator_gainprm[self._servos] = gain
        self._model.actuator_biasprm[self._servos] = bias

    def move(self, height: float) -> None:
        """Advance one step towards a height over the grasp [m]."""
        self._set_point[:] = self._base + height * self._axis
        mujoco.mj_step(self._model, self._data)

    def climb(self, way: float, film: list[LiftFrame] | None) -> None:
        """Go straight up by a way [m]."""
        self._data.ctrl[self._servos] = 0.0
        start = self._set_point.copy()
        steps = self.config.steps(way / _RISE_SPEED)
        for step in range(steps):
            self._set_point[2] = start[2] + way * (step + 1) / steps
            mujoco.mj_step(self._model, self._data)
            self._shoot("leave", step, film)

    def lower(self, film: list[LiftFrame] | None) -> None:
        """Go back down to where the grasp was."""
        config = self.config
        steps = config.steps(config.lifting)
        for step in range(steps):
            share = (1 + np.cos(np.pi * (step + 1) / steps)) / 2
            self.move(config.height * share)
            self._shoot("lower", step, film)

    def _shoot(self, phase: str, step: int, film: list[LiftFrame] | None) -> None:
        if film is not None and step % 5 == 4:
            film.append(LiftFrame(phase, self.object_poses(), self.gripper_poses()))

    def _start(self, grasp: Floats, gripper: AnyGripper, poses: Floats) -> float:
        boxes = self._world._outlines.boxes(poses)
        return start_height(grasp, boxes, gripper.boxes, self.config.headroom)

    def attempt(
        self,
        poses: Floats,
        target: int,
        grasp: Floats,
        friction: float | None,
        film: list[LiftFrame] | None,
    ) -> tuple[Outcome, set[int]]:
        raise NotImplementedError

    def open(self, film: list[LiftFrame] | None) -> None:
        raise NotImplementedError

    def gripper_poses(self) -> Floats:
        raise NotImplementedError


class Jaws:
    """The fingers of parallel jaws in a scene.

    Attributes:
        gripper: Their geometry and control.
        firmness: Stiffness of what carries them while they grasp [N/m].
    """

    firmness = GRASPING_STIFFNESS

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, index: int, gripper: Gripper
    ) -> None:
        """Take the number of the gripper, which ends the names of its parts."""
        self._model, self._data, self._index, self.gripper = model, data, index, gripper
        names = f"finger{index}left", f"finger{index}right"
        self._wrist = model.body(f"wrist{index}").id
        self._geoms = [model.geom(name).id for name in names]
        self._bodies = [model.body(name).id for name in names]
        self._servos = [model.actuator(name).id for name in names]
        self._joints = [int(model.joint(name).qposadr[0]) for name in names]
        self._speeds = [int(model.joint(name).dofadr[0]) for name in names]

    @property
    def travel(self) -> float:
        """How far a finger has closed [m]."""
        return float(self._data.qpos[self._joints[0]])

    def drive(self, travel: float) -> None:
        """Tell each finger how far to close [m]."""
        self._data.ctrl[self._servos] = travel

    def close(self) -> None:
        """Be closed on nothing, at once."""
        close_jaws(self._model, self._data, self._index, self.gripper)
        self._data.qvel[self._speeds] = 0.0

    def open(self) -> None:
        """Be open, at once."""
        self._data.qpos[self._joints] = 0.0
        self.drive(0.0)

    def stalled(self, travel: float) -> bool:
        """Return whether the fingers stand still short of the travel that they are told [m]."""
        data = self._data
        return has_stalled(travel, data.qpos[self._joints], data.qvel[self._speeds])

    def touched(self, finger: int, count: int) -> set[int]:
        """Return which of so many objects touch one finger."""
        return touching(self._model, self._data, self._geoms[finger], count)

    def poses(self) -> Floats:
        """Return the poses (3, 7) of the rendered palm and fingers."""
        place = body_pose(self._data, self._wrist)
        palm = place.copy()
        tips = np.array([0.0, 0.0, self.gripper.reach])
        palm[:3] = apply(transform_from_pose(place), self.gripper.palm_place + tips)
        fingers = [body_pose(self._data, body) for body in self._bodies]
        return np.stack([palm, *fingers])


class _JawRig(_Rig):
    """Parallel jaws."""

    gripper: Gripper

    def __init__(
        self, world: GripperWorld, models: Sequence[ObjectModel], index: int, gripper: Gripper
    ) -> None:
        super().__init__(world, models, index, gripper)
        self.gripper = gripper
        self.config = replace(self.config, closing=gripper.closing, stalling=SQUEEZE)
        self._jaws = Jaws(self._model, self._data, index, gripper)

    def let_go(self) -> None:
        """Be closed on nothing."""
        self._jaws.close()

    def drive(self, height: float, closed: float | None = None) -> None:
        """Advance one step; see `lift.Rig`."""
        if closed is not None:
            self._jaws.drive(closed)
        self.move(height)

    def stalled(self, travel: float) -> bool:
        """Return whether the fingers stand still short of the travel that they are told [m]."""
        return self._jaws.stalled(travel)

    def touched(self, finger: int) -> set[int]:
        """Return the objects that touch one finger."""
        return self._jaws.touched(finger, self.count)

    def attempt(
        self,
        poses: Floats,
        target: int,
        grasp: Floats,
        friction: float | None,
        film: list[LiftFrame] | None,
    ) -> tuple[Outcome, set[int]]:
        """Execute a grasp from the present state, nothing being near the gripper."""
        grasp = above_table(grasp, self.gripper)
        height = self._start(grasp, self.gripper, poses)
        self.aim(grasp, height, friction)
        self._jaws.open()
        test = LiftTest(self, poses, target, height, film)
        outcome = test.run()
        # What fell out in the end is not held, whatever it is.
        held = test.lifted() if self.touched(0) & self.touched(1) else set()
        return outcome, held

    def open(self, film: list[LiftFrame] | None) -> None:
        """Open the jaws where it is."""
        steps = self.config.steps(self.config.closing)
        start = self._jaws.travel
        for step in range(steps):
            self.drive(0.0, start * (1 - (step + 1) / steps))
            self._shoot("open", step, film)

    def gripper_poses(self) -> Floats:
        """Return the poses (3, 7) of the rendered palm and fingers."""
        return self._jaws.poses()


class _CupRig(_Rig):
    """A suction cup."""

    gripper: SuctionCup

    def __init__(
        self, world: GripperWorld, models: Sequence[ObjectModel], index: int, cup: SuctionCup
    ) -> None:
        super().__init__(world, models, index, cup)
        self.gripper = cup
        fast = self.config
        self.config = replace(fast, frequency=fast.frequency / 2, lifting=2 * fast.lifting)
        model = self._model
        self._lip = model.body(f"lip{index}").id
        self._lip_geom = model.geom(f"lip{index}").id
        sensors = [model.sensor(f"{kind}{index}").adr[0] for kind in ("force", "torque")]
        self._load = np.concatenate([np.arange(3) + start for start in sensors])
        self._seals = [model.eq(f"seal{index}object{i}").id for i in range(self.count)]

    def let_go(self) -> None:
        """End the vacuum."""
        self._data.eq_active[self._seals] = 0

    def drive(self, height: float) -> None:
        """Advance one step towards a height over the grasp [m]."""
        self.move(height)

    def touched(self) -> set[int]:
        """Return the objects that touch the lip."""
        return touching(self._model, self._data, self._lip_geom, self.count)

    @property
    def load(self) -> Floats:
        """Force [N] and torque [N m] of the object on the lip (6,), along the lip's axes."""
        # The engine tells what the tube puts on the lip.
        return -np.array(self._data.sensordata[self._load])

    def seal(self, number: int) -> bool:
        """Hold an object by vacuum if it closes the cup all around; return whether it does."""
        data = self._data
        lip, body = body_pose(data, self._lip), body_pose(data, number + 1)
        if not seal_of(self.gripper, lip, self._models[number], body):
            return False
        equality = self._seals[number]
        to_body = np.zeros(3)
        inverse, turn = np.zeros(4), np.zeros(4)
        mujoco.mju_negQuat(inverse, body[3:])
        mujoco.mju_rotVecQuat(to_body, lip[:3] - body[:3], inverse)
        mujoco.mju_negQuat(inverse, lip[3:])
        mujoco.mju_mulQuat(turn, inverse, body[3:])
        self._model.eq_data[equality, :10] = [*to_body, 0.0, 0.0, 0.0, *turn]
        data.eq_active[equality] = 1
        return True

    def attempt(
        self,
        poses: Floats,
        target: int,
        grasp: Floats,
        friction: float | None,
        film: list[LiftFrame] | None,
    ) -> tuple[Outcome, set[int]]:
        """Execute a grasp from the present state, nothing being near the gripper."""
        height = self._start(grasp, self.gripper, poses)
        self.aim(grasp, height, friction)
        test = SuctionTest(self, poses, target, height, film)
        return test.run(), test.lifted()

    def open(self, film: list[LiftFrame] | None) -> None:
        """End the vacuum where it is."""
        self.let_go()
        for step in range(10):
            self.move(0.0)
            self._shoot("open", step, film)

    def gripper_poses(self) -> Floats:
        """Return the poses (2, 7) of the rendered lip and tube."""
        return open_parts(self.gripper, body_pose(self._data, self._wrist))
