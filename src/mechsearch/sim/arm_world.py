"""A heap and an arm that pushes with its closed fingers."""

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np

from mechsearch.objects.model import ObjectModel
from mechsearch.sim.arm import Arm, ArmMotion
from mechsearch.sim.motion import Plan, kinematics_of
from mechsearch.sim.scene import PhysicsConfig, Pusher, Tool, Workspace, pusher_model
from mechsearch.sim.world import World
from mechsearch.types import Array, Floats

_FREQUENCY = 25.0
"""Natural, of how the arm is damped and keeps its posture [rad/s]."""

_TURNING_STIFFNESS = 150.0
"""With which the tool is held straight [N m/rad]."""

_NEXT, _AFTER = [1, 2, 0], [2, 0, 1]
"""Of x, y and z, the next, and the one after that."""

_NO_ROOM = 1e-9
"""Of a joint that is as fast as it may be [rad/s]."""

_MEETINGS = {
    frozenset({"link", "heap"}): "heap",
    frozenset({"link", "table"}): "table",
    frozenset({"link"}): "itself",
    frozenset({"link", "tool"}): "itself",
}
"""What touches what, and how it is called."""

_PADS = ("pusher", "palm0", "finger0left", "finger0right")
"""Parts of the tool that may meet the heap."""

_GREY = 182

_SETTLED = 4
"""Steps between two looks whether an action is over early."""


class ArmWorld(World):
    """Objects on a table, and an arm that holds the pusher straight down, its yaw free.

    Its control gives way like the free pusher's: at the tip it acts as a spring of the same
    stiffness, which presses no harder along each axis, beside what carries and speeds up the arm
    itself. Joints and their velocities are part of the engine's state, and control has none of its
    own: a snapshot taken between actions has all that the next one depends on.
    """

    def __init__(
        self,
        models: Sequence[ObjectModel],
        arm: Arm,
        workspace: Workspace | None = None,
        pusher: Tool | None = None,
        config: PhysicsConfig | None = None,
    ) -> None:
        """Compile a scene.

        Args:
            models: The objects, in the order of all poses.
            arm: The arm.
            workspace: Table and bounds.
            pusher: The tool; of a gripper the closed jaws.
            config: Numerical choices.

        Raises:
            MechSearchError: If the library for inverse kinematics is not there.
        """
        tool = pusher or Pusher()
        self._kinematics = kinematics_of(arm, tool)
        super().__init__(models, workspace, tool, (), config, (), arm)
        self.arm, self._tool, self.motion = arm, tool, None
        joints = len(arm.links)
        self._angles: Floats = self._qpos[7 * self.count :][:joints]
        self._speeds: Floats = self._qvel[6 * self.count :][:joints]
        self._motors: Floats = self._data.ctrl[:joints]
        self._low, self._high = arm.of_joints("low"), arm.of_joints("high")
        self._limits = arm.of_joints("velocity"), arm.of_joints("torque")
        self._most_of_all = np.concatenate(self._limits)
        self._soften()
        model, first = self._model, int(self._robot_geoms[0])
        self._kinds = np.where(np.arange(model.ngeom) >= first, "link", "heap")
        self._kinds[model.geom("table").id] = "table"
        self._pads = [g for g in range(first, model.ngeom) if model.geom(g).name in _PADS]
        self._kinds[self._pads] = "tool"
        self._is_away, self._watch = True, _Watch(len(self._angles))

    @property
    def pusher_position(self) -> Floats:
        """Position (3,) of the fingertip [m]."""
        return self._kinematics.position(self._angles)

    def place_pusher(self, position: Array) -> None:
        """Put the arm at rest with the tip at a position (3,) [m], or at home if it cannot."""
        found = self._kinematics.inverse(position)
        self._is_away = isinstance(found, str) or self._kinematics.refusal(found) is not None
        self._angles[:] = self.arm.home if self._is_away else found
        self._speeds[:] = 0.0

    def pusher_is_free(self) -> bool:
        """Return whether the arm is where it was last placed, and touches nothing there."""
        return not self._is_away and super().pusher_is_free()

    def step(self, steps: int) -> None:
        """Advance by a number of time steps, the arm holding still."""
        held, still = self._angles.copy(), np.zeros(len(self._angles))
        for _ in range(steps):
            self._drive(held, still, still)

    def push(self, target: Array) -> bool:
        """Move the tip straight towards `target` (3,) [m], as fast as the arm's limits allow.

        All of it is checked before it begins; `motion` tells what was refused or done.

        Returns:
            Whether anything was simulated; a refusal moves nothing.
        """
        config, nothing = self.config, np.zeros(len(self._angles))
        plan = self._kinematics.plan(self._angles, target, config.time_step, config.action_steps)
        if isinstance(plan, str):
            self._refuse(plan)
            return False
        self._watch = _Watch(len(nothing))
        steps = len(plan.angles) + config.rest_steps
        ends = self._data.time + steps * config.time_step
        self._wake()
        self._follow(plan)
        for step in range(config.rest_steps):
            if config.stops_when_still and step % _SETTLED == 0 and self._lies_still():
                break
            self._drive(plan.angles[-1], nothing, nothing)
        self._data.time = ends
        self._note_motion(steps * config.time_step)
        return True

    def _refuse(self, reason: str) -> None:
        """Note that nothing has moved, and why."""
        nothing = np.zeros(len(self._angles))
        self.motion = ArmMotion(reason, 0.0, nothing, nothing, self._margin())

    def _note_motion(self, seconds: float) -> None:
        """Note what was seen of a motion that took so long [s]."""
        watch, (fastest, strongest) = self._watch, self._limits
        self.motion = ArmMotion(
            None, seconds, watch.speeds / fastest, watch.torques / strongest,
            watch.margin, tuple(sorted(watch.touched)),
        )  # fmt: skip

    def _soften(self) -> None:
        """Let the tip give way as a pusher does."""
        self._spring(self._tool.stiffness, self._tool.force, self._tool.force)

    def _spring(
        self, stiffness: float, press: float, force: float, damping: float = _FREQUENCY
    ) -> None:
        """Set the tip's spring [N/m], its largest forces downwards and else [N], its damping."""
        self._stiffness = np.repeat([stiffness, _TURNING_STIFFNESS], 3)
        self._damping = damping
        self._least, self._most = np.full(3, -force), np.full(3, force)
        self._least[2] = -press

    def _follow(self, plan: Plan) -> None:
        """Carry out a plan."""
        for moment in zip(plan.angles, plan.velocities, plan.accelerations, strict=True):
            self._drive(*moment)

    def _drive(self, angles: Floats, velocities: Floats, accelerations: Floats) -> None:
        """Advance one step towards a point of a plan."""
        wanted = self._kinematics.dynamics(angles, velocities)
        now = self._kinematics.dynamics(self._angles, self._speeds)
        lag, slip = angles - self._angles, velocities - self._speeds
        has, should = now.rotation, wanted.rotation
        # Half the sum of the axes' cross products, many times as fast as by `np.cross`.
        turn = (has[_NEXT] * should[_AFTER] - has[_AFTER] * should[_NEXT]).sum(axis=1) / 2
        error = np.concatenate([wanted.position - now.position, turn])
        loose = np.linalg.solve(now.inertia, now.jacobian.T)
        mass = np.linalg.inv(now.jacobian @ loose + 1e-6 * np.eye(6))
        force = self._stiffness * error + 2 * self._damping * mass @ (now.jacobian @ slip)
        force[:3] = np.clip(force[:3], self._least, self._most)
        # What moves no tip: an arm of more joints than it needs keeps its posture by it.
        restored = _FREQUENCY**2 * lag + 2 * _FREQUENCY * slip
        posture = now.inertia @ restored
        felt = mass @ (loose.T @ posture)
        posture -= now.jacobian.T @ felt
        asked = now.bias + now.inertia @ accelerations + now.jacobian.T @ force + posture
        pace = accelerations + restored + loose @ (force - felt)
        self._motors[:] = torque = self._given(asked, now.bias, pace)
        mujoco.mj_step(self._model, self._data)
        self._watch.note(self._speeds, torque, self._margin(), self._touches())

    def _given(self, torque: Floats, weight: Floats, pace: Floats) -> Floats:
        """Return what is asked of the joints (J,) [N m], as much of it as all of them can give.

        The weight is carried first. All else, which would speed the joints up by `pace` (J,)
        [rad/s^2], shrinks alike, until no joint gives more than its torque or gets faster than it
        may: the tip presses where it would, only less, while joints that were clipped one by one
        would turn the force aside.
        """
        faster = pace * self.config.time_step
        if (np.abs(np.concatenate([self._speeds + faster, torque])) <= self._most_of_all).all():
            return torque
        (fastest, strongest), more = self._limits, torque - weight
        room = np.maximum(fastest - np.copysign(self._speeds, self._speeds * pace), _NO_ROOM)
        excess = max(
            float((more / (np.copysign(strongest, more) - weight)).max()),
            float((np.abs(faster) / room).max()),
        )
        return weight + more / max(excess, 1.0)

    def _margin(self) -> float:
        return float(np.minimum(self._angles - self._low, self._high - self._angles).min())

    def _touches(self) -> set[str]:
        """Return what links touched in the last computed step."""
        pairs = self._data.contact.geom[: self._data.ncon]
        own = pairs[(pairs >= self._robot_geoms[0]).any(axis=1)]
        meetings = {frozenset(pair) for pair in self._kinds[own].tolist()}
        return {_MEETINGS[pair] for pair in meetings if pair in _MEETINGS}


class _Watch:
    """What the limits of an arm are held against, over one action."""

    def __init__(self, joints: int) -> None:
        self.speeds, self.torques = np.zeros((2, joints))
        self.margin, self.touched = np.inf, set[str]()

    def note(self, speeds: Floats, torques: Floats, margin: float, touched: set[str]) -> None:
        """Take one step."""
        self.speeds = np.maximum(self.speeds, np.abs(speeds))
        self.torques = np.maximum(self.torques, np.abs(torques))
        self.margin = min(self.margin, margin)
        self.touched |= touched


def shown_at(arm: Arm, pusher: Pusher, positions: Floats) -> tuple[list[ObjectModel], Floats]:
    """Return what there is to draw of an arm and its tool, and where it is.

    Args:
        arm: The arm.
        pusher: Its tool.
        positions: Of the tip (T, 3) [m], where the arm has been.

    Returns:
        The P parts, and their poses (T, P, 7).

    Raises:
        MechSearchError: If the library for inverse kinematics is not there.
    """
    kinematics, angles, poses = kinematics_of(arm, pusher), np.array(arm.home), []
    for position in positions:
        found = kinematics.inverse(position, angles)
        angles = angles if isinstance(found, str) else found
        poses.append(kinematics.poses(angles))
    return [*links_of(arm, pusher)[:-1], pusher_model(pusher)], np.array(poses)


def links_of(arm: Arm, tool: Tool) -> list[ObjectModel]:
    """Return what there is to draw of an arm and its tool, as `Kinematics.poses` places it."""
    sizes = kinematics_of(arm, tool).sizes
    models = [pusher_model(Pusher(radius, length)) for radius, length in sizes]
    return [replace(link, texels=np.full_like(link.texels, _GREY)) for link in models]
