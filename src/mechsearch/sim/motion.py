"""What an arm can do: inverse kinematics, and motions that are checked before they begin."""

import importlib
from dataclasses import dataclass
from functools import cache
from typing import Any

import mujoco
import numpy as np
from numpy.polynomial.polynomial import polyder, polyval

from mechsearch.sim.arm import (
    JOINT_LIMIT,
    OUT_OF_REACH,
    SELF_COLLISION,
    SINGULARITY,
    TABLE,
    Arm,
)
from mechsearch.sim.scene import PhysicsConfig, Tool, Workspace, compile_scene
from mechsearch.types import Array, Floats, check_extra

_MARGIN = 0.05
"""Joints stay so far from their limits [rad]."""

_LEAST_MANIPULABILITY = 0.03
"""Of the tool's position and tilt: their slowest change for a unit of joint velocity [m, rad]."""

TOOL_SPEED = 0.25
"""Of the tool, at most [m/s]: reduced speed in ISO 10218-1, with people near."""

_SHARES = 0.8, 0.5
"""Of the limits of velocity and torque that a plan takes; the rest is for control and contacts."""

_OTHER_POSTURE = np.pi / 2
"""An arm so far from home [rad] has its elbow or wrist the other way, where it soon gets stuck: it
is not placed like that."""

_HOMING = 0.1
"""Share of its way home that what is left free, the yaw above all, goes from each waypoint to the
next: nothing jumps, and nothing drifts."""

_WAYPOINTS, _MOST_WAYPOINTS, _SAMPLES = 4, 8, 17
_APART = 0.06, 0.4
"""Waypoints of longer ways are at most so far apart, as far as there are enough [m, rad]."""

_BETWEEN = 4
"""Looks for collisions from one waypoint to the next."""

_NEAR, _UPRIGHT = 1e-4, 1e-3
"""How well the inverse is solved [m, rad]."""

PEAK = 15 / 8
"""Largest velocity on a quintic's way over its mean."""


@dataclass(frozen=True)
class Plan:
    """A motion of the joints, step by step, from rest to rest.

    Attributes:
        angles: After each of S steps (S, J) [rad].
        velocities: Likewise (S, J) [rad/s].
        accelerations: Likewise (S, J) [rad/s^2].
    """

    angles: Floats
    velocities: Floats
    accelerations: Floats


@dataclass(frozen=True)
class Dynamics:
    """Of an arm at one instant.

    Attributes:
        inertia: Of the joints (J, J) [kg m^2].
        bias: Torques that hold it against weight and its own motion (J,) [N m].
        jacobian: Of the tip: velocity and angular velocity by joint velocity (6, J).
        position: Of the tip (3,) [m].
        rotation: Of the tool, its z axis against the approach (3, 3).
    """

    inertia: Floats
    bias: Floats
    jacobian: Floats
    position: Floats
    rotation: Floats


class Kinematics:
    """An arm that holds a tool, without anything around it but the table.

    The tool is the pusher, or a gripper, which is taken as if it were always open.

    Every answer depends on what is asked alone, not on what was asked before.

    Attributes:
        arm: The arm.
        sizes: Radius and length [m] of each capsule of arm and tool, the tool's the last.
    """

    def __init__(self, arm: Arm, tool: Tool) -> None:
        """Compile the arm.

        Raises:
            MechSearchError: If the library for inverse kinematics is not there.
        """
        check_extra(f"robot {arm.name!r}", "arms")
        mink: Any = importlib.import_module("mink")
        self.arm, self._mink = arm, mink
        self._model = model = compile_scene(
            (), Workspace(), tool, (), PhysicsConfig(), arm=arm, with_fingers=False
        )
        self._data = mujoco.MjData(model)
        self._tip = model.site("tip").id
        self._table = model.geom("table").id
        self._capsules = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE)
        self.sizes = [
            (r, 2 * (half + r)) for r, half, _ in model.geom_size[self._capsules].tolist()
        ]
        self._home = np.array(arm.home)
        self._low, self._high = (
            model.jnt_range[:, side] + sign * _MARGIN for side, sign in ((0, 1), (1, -1))
        )
        self._velocity, self._torque = arm.of_joints("velocity"), arm.of_joints("torque")
        self._place = mink.FrameTask("tip", "site", position_cost=1.0, orientation_cost=0.0)
        upright = mink.AxisAlignTask("tip", "site", axis=(0.0, 0.0, 1.0), cost=1.0)
        upright.set_target(np.array([0.0, 0.0, 1.0]))
        self._pose = mink.FrameTask("tip", "site", position_cost=1.0, orientation_cost=1.0)
        self._posture = mink.PostureTask(model, cost=1e-3)
        self._tasks = [self._place, upright, self._posture]
        self._configuration = mink.Configuration(model, self._home)
        names = [model.joint(number).name for number in range(model.njnt)]
        self._limits = [
            mink.ConfigurationLimit(model, gain=1.0, min_distance_from_limits=_MARGIN),
            mink.VelocityLimit(model, dict.fromkeys(names, 0.5)),
        ]

    def position(self, angles: Array) -> Floats:
        """Return where the tip is (3,) [m] at joint angles (J,) [rad]."""
        self._data.qpos[:] = angles
        mujoco.mj_kinematics(self._model, self._data)
        return np.array(self._data.site_xpos[self._tip])

    def poses(self, angles: Array) -> Floats:
        """Return the poses (P, 7) of all capsules at joint angles (J,) [rad], as `sizes` has them.

        The origin of each is its lowest point along its z axis, like a pusher's.
        """
        self.position(angles)
        poses = np.empty((len(self.sizes), 7))
        for pose, geom, (_, length) in zip(poses, self._capsules, self.sizes, strict=True):
            turn = self._data.geom_xmat[geom]
            pose[:3] = self._data.geom_xpos[geom] - turn[2::3] * length / 2
            mujoco.mju_mat2Quat(pose[3:], turn)
        return poses

    def dynamics(self, angles: Array, velocities: Array) -> Dynamics:
        """Return the arm's state at joint angles (J,) [rad] and velocities (J,) [rad/s]."""
        model, data = self._model, self._data
        data.qpos[:], data.qvel[:] = angles, velocities
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_crb(model, data)
        mujoco.mj_comVel(model, data)
        inertia, bias = np.empty((model.nv, model.nv)), np.empty(model.nv)
        mujoco.mj_fullM(model, data, inertia)
        mujoco.mj_rne(model, data, 0, bias)
        return Dynamics(
            inertia, bias, self._jacobian(), np.array(data.site_xpos[self._tip]),
            data.site_xmat[self._tip].reshape(3, 3).copy(),
        )  # fmt: skip

    def rotation(self, angles: Array) -> Floats:
        """Return the tool's rotation (3, 3) at joint angles (J,) [rad]."""
        self.position(angles)
        return np.array(self._data.site_xmat[self._tip]).reshape(3, 3)

    def inverse(
        self, position: Array, start: Array | None = None, rotation: Array | None = None
    ) -> Floats | str:
        """Return joint angles (J,) [rad] that hold the tool with its tip at a position.

        Args:
            position: Of the tip (3,) [m].
            start: Angles (J,) from which they are sought; by default home, facing the position.
            rotation: Of the tool (3, 3); None holds it upright, whatever its yaw.

        Returns:
            The angles, or the name of the reason why there are none: `OUT_OF_REACH`, or
            `JOINT_LIMIT` where a joint is at the end of its way, or far from home.
        """
        mink, configuration = self._mink, self._configuration
        facing = self._home.copy()
        facing[0] += np.arctan2(*(np.asarray(position)[:2] - self.arm.base[:2])[::-1])
        begin = facing if start is None else np.asarray(start, np.float64)
        self._posture.set_target(begin + _HOMING * (facing - begin))
        configuration.update(begin)
        place, tasks = self._place, self._tasks
        if rotation is not None:
            place, tasks = self._pose, [self._pose, self._posture]
        for _ in range(60):
            now = configuration.get_transform_frame_to_world("tip", "site")
            turn = now.rotation() if rotation is None else mink.SO3.from_matrix(rotation)
            target = mink.SE3.from_rotation_and_translation(turn, np.asarray(position))
            place.set_target(target)
            try:
                step = mink.solve_ik(configuration, tasks, 1.0, "daqp", 1e-9, limits=self._limits)
            except mink.NoSolutionFound:
                break
            configuration.integrate_inplace(step, 1.0)
            if np.abs(step).max() < 1e-5:
                break
        angles: Floats = configuration.q.copy()
        error = np.linalg.norm(self.position(angles) - position)
        found = self._data.site_xmat[self._tip].reshape(3, 3)
        if rotation is None:
            tilt = float(np.linalg.norm(found[:2, 2]))
        else:
            tilt = float(np.linalg.norm(found - rotation))
        if error < _NEAR and tilt < _UPRIGHT:
            turned = start is None and np.abs(angles - facing).max() > _OTHER_POSTURE
            return JOINT_LIMIT if turned else angles
        ends = (angles < self._low + 1e-3) | (angles > self._high - 1e-3)
        return JOINT_LIMIT if ends.any() else OUT_OF_REACH

    def manipulability(self, angles: Array) -> float:
        """Return how fast position and tilt change at least for a unit of joint velocity."""
        state = self.dynamics(angles, np.zeros(len(self._home)))
        rows = np.concatenate([state.jacobian[:3], state.rotation[:, :2].T @ state.jacobian[3:]])
        return float(np.linalg.svd(rows, compute_uv=False)[-1])

    def refusal(self, angles: Array) -> str | None:
        """Return why the arm must not be at joint angles (J,) [rad], or None."""
        if ((angles < self._low - 1e-3) | (angles > self._high + 1e-3)).any():
            return JOINT_LIMIT
        if self.manipulability(angles) < _LEAST_MANIPULABILITY:
            return SINGULARITY
        return self._collision()

    def _collision(self) -> str | None:
        """Return what the arm would touch where it was last put, of `REFUSED`, or None."""
        mujoco.mj_collision(self._model, self._data)
        if not self._data.ncon:
            return None
        return TABLE if (self._data.contact.geom == self._table).any() else SELF_COLLISION

    def path(
        self, start: Array, goal: Array, rotation: Array | None = None
    ) -> tuple[Floats, float] | str:
        """Return the joints' way while the tip goes straight to a goal, or why it is refused.

        Args:
            start: Joint angles (J,) [rad].
            goal: Of the tip (3,) [m].
            rotation: Of the tool at the end (3, 3), to which it turns evenly; None holds it
                upright, whatever its yaw.

        Returns:
            The polynomial in the share of the way, the lowest power first (P, J), and the length
            of the way [m].
        """
        begin = self.position(start)
        way = np.asarray(goal, np.float64) - begin
        length, turn, count = float(np.linalg.norm(way)), np.zeros(3), _WAYPOINTS
        if rotation is not None:
            held = self.rotation(start)
            turn = _rotation_vector(rotation @ held.T)
        needed = max(length / _APART[0], float(np.linalg.norm(turn)) / _APART[1])
        count = min(max(count, int(np.ceil(needed))), _MOST_WAYPOINTS)
        path = [np.array(start, np.float64)]
        for share in np.arange(1, count + 1) / count:
            towards = None if rotation is None else _turned(held, share * turn)
            angles = self.inverse(begin + share * way, path[-1], towards)
            if isinstance(angles, str):
                return angles
            refused = self.refusal(angles)
            if refused is not None:
                return refused
            path.append(angles)
        # The polynomial through all of them, the lowest power first.
        powers = np.vander(np.linspace(0.0, 1.0, len(path)), increasing=True)
        curve = np.asarray(np.linalg.solve(powers, np.array(path)), np.float64)
        # Between them it may swing out.
        for share in (np.arange(_BETWEEN * count) + 0.5) / (_BETWEEN * count):
            self.position(polyval(share, curve))
            met = self._collision()
            if met is not None:
                return met
        return curve, length

    def plan(
        self, start: Array, goal: Array, time_step: float, least: int, rotation: Array | None = None
    ) -> Plan | str:
        """Return the motion that brings the tip straight to a goal, or why it is refused.

        It lasts as long as the slowest of its limits demands: the tool's speed, the joints'
        velocities and torques.

        Args:
            start: Joint angles (J,) [rad].
            goal: Of the tip (3,) [m].
            time_step: Of the control [s].
            least: Fewest steps.
            rotation: Of the tool at the end; see `path`.
        """
        found = self.path(start, goal, rotation)
        if isinstance(found, str):
            return found
        curve, length = found
        seconds = max(self.least_time(curve), PEAK * length / TOOL_SPEED)
        steps = max(int(np.ceil(seconds / time_step)), least)
        share = np.arange(1, steps + 1) / steps
        return Plan(*_quintic(curve, share, steps * time_step))

    def least_time(self, curve: Floats) -> float:
        """Return how long a way (P, J) must take for the joints' limits [s]; see `path`."""
        moments = _quintic(curve, np.linspace(0.0, 1.0, _SAMPLES), 1.0)
        return max(self.haste(*moment) for moment in zip(*moments, strict=True))

    def haste(self, angles: Floats, velocities: Floats, accelerations: Floats) -> float:
        """Return how many times too fast a motion is for the joints' limits at one instant.

        Args:
            angles: (J,) [rad].
            velocities: (J,) [rad/s].
            accelerations: (J,) [rad/s^2].
        """
        weight = self.dynamics(angles, np.zeros_like(velocities)).bias
        moving = self.dynamics(angles, velocities)
        # What is not weight falls with the square of the time that a motion takes.
        torque = np.abs(moving.inertia @ accelerations + moving.bias - weight)
        room = np.maximum(_SHARES[1] * self._torque - np.abs(weight), 0.1 * self._torque)
        speed = np.abs(velocities) / (_SHARES[0] * self._velocity)
        return float(max(speed.max(), np.sqrt((torque / room).max())))

    def _jacobian(self) -> Floats:
        jacobian = np.empty((6, self._model.nv))
        mujoco.mj_jacSite(self._model, self._data, jacobian[:3], jacobian[3:], self._tip)
        return jacobian


@cache
def kinematics_of(arm: Arm, tool: Tool) -> Kinematics:
    """Return an arm's kinematics, which are compiled once."""
    return Kinematics(arm, tool)


def _rotation_vector(rotation: Floats) -> Floats:
    """Return the axis (3,) about which a matrix (3, 3) turns, as long as the angle [rad]."""
    quaternion, vector = np.empty(4), np.empty(3)
    mujoco.mju_mat2Quat(quaternion, rotation.ravel())
    mujoco.mju_quat2Vel(vector, quaternion, 1.0)
    return vector


def _turned(rotation: Floats, vector: Floats) -> Floats:
    """Return a rotation (3, 3) turned about an axis (3,) as long as the angle [rad]."""
    quaternion, matrix = np.array([1.0, 0.0, 0.0, 0.0]), np.empty(9)
    mujoco.mju_quatIntegrate(quaternion, vector, 1.0)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3) @ rotation


def _quintic(curve: Floats, u: Floats, seconds: float) -> tuple[Floats, Floats, Floats]:
    """Return angles, velocities and accelerations at shares `u` (S,) of the time of a way."""
    s = u**3 * (10 - 15 * u + 6 * u**2)
    ds = (30 * u**2 * (1 - u) ** 2 / seconds)[:, None]
    dds = (60 * u * (1 - u) * (1 - 2 * u) / seconds**2)[:, None]
    along, slope, bend = (np.asarray(polyval(s, polyder(curve, n)).T, np.float64) for n in range(3))
    return along, slope * ds, bend * ds**2 + slope * dds
