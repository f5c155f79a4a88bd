"""A heap and an arm whose gripper pushes with closed jaws, grasps, holds, releases, puts aside.

All of it is one simulation: whatever moves the gripper is the arm, link by link.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any
from weakref import proxy

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval

from mechsearch.geometry import rotation_from_quaternion
from mechsearch.sim.arm_world import ArmWorld
from mechsearch.sim.gripper_world import SQUEEZE, Attempt, Jaws
from mechsearch.sim.lift import (
    LiftConfig,
    LiftFrame,
    LiftTest,
    above_table,
    eased,
    is_unsound,
    start_height,
)
from mechsearch.sim.motion import PEAK, TOOL_SPEED, Plan
from mechsearch.types import Array, Floats, MechSearchError, Outcome

_OVER = 0.01
"""Between the highest of the heap and the tips that travel over it [m]."""

_TRAY = (-0.3, 0.5, 0.35)
"""Over the tray on one side of the base, and with a negative y on the other: what leaves the table
there is out of the scene [m]."""

_MOST_ACCELERATION = 10.0
"""Along the approach, that control feeds forward [m/s^2]."""

_GRASPING_DAMPING = 60.0
"""Of the stiff spring [rad/s]."""

_SHAKES = 3
"""Whole periods of the shake."""

_TURNED = np.diag([-1.0, -1.0, 1.0])
"""Jaws that are turned by half are the same."""


@dataclass(frozen=True, eq=False)
class _Way:
    """All motions of one grasp, which are possible from where the arm is.

    Attributes:
        there: To above the grasp.
        base: Of the tips at the grasp (3,) [m].
        axis: Against the approach (3,).
        height: Above the grasp, along the axis, where it begins and ends [m].
        curve: Polynomial of the joint angles along the approach (P, J); see `Kinematics.path`.
        config: How it is lifted and shaken.
        back: From above the grasp to where pushes can begin.
        aside: From the end of the lift to the tray.
        from_tray: From the tray to where pushes can begin.
    """

    there: tuple[Plan, ...]
    base: Floats
    axis: Floats
    height: float
    curve: Floats
    config: LiftConfig
    back: Plan
    aside: Plan
    from_tray: Plan


class ArmGripperWorld(ArmWorld):
    """Objects on a table, and an arm that holds jaws.

    Before a grasp all of its motions are checked: over the heap to above the grasp, down, up with
    what it holds, to the tray, and back. Where one of them is refused nothing moves, and `motion`
    has the reason. Jaws open above a grasp, and close above it when they are empty, at once.

    Its `pusher` is the gripper.
    """

    _rig: "_ArmRig | None" = None
    _lifted: tuple[int, ...] = ()
    _steps = 0

    @cached_property
    def jaws(self) -> Jaws:
        """What it holds."""
        tool: Any = self._tool
        return Jaws(self._model, self._data, 0, tool)

    def place_pusher(self, position: Array) -> None:
        """Put the arm at rest with closed jaws, the tips at a position; see `ArmWorld`."""
        super().place_pusher(position)
        self._rig, self._lifted = None, ()
        self._let_go()

    def attempt(
        self,
        target: int,
        pose: Array,
        gripper: int = 0,
        friction: float | None = None,
        film: list[LiftFrame] | None = None,
    ) -> Attempt:
        """Grasp, lift and shake; see `GripperWorld.attempt`. A refused grasp is blocked."""
        if not 0 <= target < self.count or gripper:
            raise MechSearchError(
                f"target {target} and gripper {gripper}; expected 0 to {self.count - 1} and 0"
            )
        if self._rig is not None:
            raise MechSearchError("the gripper holds something; release or stow it first")
        jaws = self.jaws.gripper
        way = self._way_to(above_table(np.asarray(pose, np.float64), jaws))
        if isinstance(way, str):
            self._refuse(way)
            return Attempt(Outcome.BLOCKED)
        self._watch, self._steps = type(self._watch)(len(self._angles)), 0
        self._wake()
        for plan in way.there:
            self._follow(plan, film, "reach")
        self._model.geom_friction[self._pads, 0] = jaws.friction if friction is None else friction
        self._spring(self.jaws.firmness, jaws.press, jaws.pull, _GRASPING_DAMPING)
        self.jaws.open()
        self._rig = rig = _ArmRig(self, way)
        self._test = test = LiftTest(rig, self.poses, target, way.height, film)
        outcome = test.run()
        held = test.lifted() if rig.touched(0) & rig.touched(1) else set()
        self._lifted = tuple(sorted(held))
        self._end()
        return Attempt(outcome, self._lifted)

    def release(self, film: list[LiftFrame] | None = None) -> None:
        """Put what is held back where it was, leave it along the approach, and close the jaws."""
        rig = self._released()
        if self._lifted:
            rig.go(0.0, film, "lower")
            steps, start = rig.config.steps(rig.config.closing), self.jaws.travel
            for step in range(steps):
                rig.drive(0.0, start * (1 - (step + 1) / steps))
                self._shoot(film, "open")
        rig.go(rig.way.height, film, "leave")
        self._let_go()
        self._follow(rig.way.back, film, "leave")
        self._end()

    def stow(self, film: list[LiftFrame] | None = None) -> tuple[int, ...]:
        """Carry what is held to the tray; return what has arrived there, out of the scene."""
        rig = self._released()
        rig.go(rig.config.height, film, "carry")
        self._follow(rig.way.aside, film, "carry")
        up = self._test.lifted()
        stowed = tuple(index for index in self._lifted if index in up)
        for index in stowed:
            self.remove(index)
        self._let_go()
        self._follow(rig.way.from_tray, film, "leave")
        self._end()
        return stowed

    def settle(self, seconds: float = 2.0) -> None:
        """Let the heap come to rest, the arm standing still, for at most so long [s]."""
        self._wake()
        self._rest(round(seconds / self.config.time_step))

    def gripper_poses(self, gripper: int = 0) -> Floats:
        """Return the poses (P, 7) of jaws and arm, as last computed; see `links_of`."""
        del gripper
        return np.concatenate([self.jaws.poses(), self._kinematics.poses(self._angles)])

    def _way_to(self, grasp: Floats) -> _Way | str:
        """Return the motions of a grasp (7,), or the reason why one of them is refused."""
        jaws, usual = self.jaws.gripper, LiftConfig(physics=self.config)
        rotation = rotation_from_quaternion(grasp[3:])
        axis = rotation[:, 2]
        base = grasp[:3] - jaws.reach * axis
        low, high = self._outlines.boxes(self._objects)
        over = float(high[high[:, 2] < 1.0, 2].max(initial=0.0)) + _OVER
        height = max(
            start_height(grasp, (low, high), jaws.boxes, usual.headroom),
            (over - base[2]) / axis[2],
            usual.height + usual.shake,
        )
        above = base + height * axis
        away = self.workspace.clip(np.array([*base[:2], self.workspace.high]))
        away[2] = max(away[2], over)
        tray = np.array(_TRAY) * [1.0, 1.0 if grasp[1] >= 0 else -1.0, 1.0]
        there, start = [], self._angles.copy()
        tip = self.pusher_position
        try:
            if tip[2] < over:
                there = [self._leg(start, np.array([*tip[:2], over]))]
                start = there[0].angles[-1]
            reach, curve = self._approach(start, above, base, rotation)
            paced = replace(usual, closing=jaws.closing, stalling=SQUEEZE)
            config = self._paced(paced, curve, height)
            back = self._leg(reach.angles[-1], away)
            lifted, *_ = _along(curve, 1 - config.height / height)
            aside = self._leg(lifted, tray)
            from_tray = self._leg(aside.angles[-1], away)
        except _RefusedError as refused:
            return str(refused)
        return _Way((*there, reach), base, axis, height, curve, config, back, aside, from_tray)

    def _leg(self, start: Floats, goal: Floats, rotation: Floats | None = None) -> Plan:
        """Return the motion from joint angles (J,) straight to a goal; see `Kinematics.plan`."""
        config = self.config
        found = self._kinematics.plan(start, goal, config.time_step, config.action_steps, rotation)
        if isinstance(found, str):
            raise _RefusedError(found)
        return found

    def _approach(
        self, start: Floats, above: Floats, base: Floats, rotation: Floats
    ) -> tuple[Plan, Floats]:
        """Return the motion to above a grasp, and the joints' way from there down to it.

        The jaws turn the shorter way, if that one can be gone.
        """
        held, refused = self._kinematics.rotation(start), None
        ways = rotation, rotation @ _TURNED
        for turn in sorted(ways, key=lambda way: -float(np.trace(way.T @ held))):
            try:
                reach = self._leg(start, above, turn)
            except _RefusedError as error:
                refused = refused or error
                continue
            down = self._kinematics.path(reach.angles[-1], base, turn)
            if not isinstance(down, str):
                return reach, down[0]
            refused = refused or _RefusedError(down)
        assert refused is not None
        raise refused

    def _paced(self, config: LiftConfig, curve: Floats, height: float) -> LiftConfig:
        """Return how a grasp is lifted and shaken, as fast as tool and joints may."""
        kinematics = self._kinematics
        mean = TOOL_SPEED / PEAK
        slower = max(1.0, kinematics.least_time(curve) / (height / mean))
        rate = TOOL_SPEED / config.shake
        angles, slope, _ = _along(curve, 1 - config.height / height)
        per_metre = slope / -height
        haste = max(
            kinematics.haste(angles, np.zeros_like(angles), per_metre * config.shake * rate**2),
            kinematics.haste(angles, per_metre * TOOL_SPEED, np.zeros_like(angles)),
            1.0,
        )
        frequency = rate / haste / (2 * np.pi)
        return replace(
            config, gentle=True, descent_speed=mean / slower,
            lifting=config.height / mean * slower, frequency=frequency,
            shaking=_SHAKES / frequency,
        )  # fmt: skip

    def _released(self) -> "_ArmRig":
        rig, self._rig = self._rig, None
        if rig is None:
            raise MechSearchError("the gripper holds nothing; attempt a grasp first")
        return rig

    def _let_go(self) -> None:
        """Be closed on nothing, and push again."""
        self.jaws.close()
        self._model.geom_friction[self._pads, 0] = self.jaws.gripper.friction
        self._soften()

    def _follow(self, plan: Plan, film: list[LiftFrame] | None = None, phase: str = "") -> None:
        for moment in zip(plan.angles, plan.velocities, plan.accelerations, strict=True):
            self._drive(*moment)
            self._shoot(film, phase)

    def _drive(self, angles: Floats, velocities: Floats, accelerations: Floats) -> None:
        super()._drive(angles, velocities, accelerations)
        self._steps += 1

    def _end(self) -> None:
        self._note_motion(self._steps * self.config.time_step)

    def _shoot(self, film: list[LiftFrame] | None, phase: str) -> None:
        if film is not None and self._steps % 5 == 4:
            film.append(LiftFrame(phase, self.poses, self.gripper_poses()))


class _ArmRig:
    """The gripper on its way along one approach; see `lift.Rig`."""

    def __init__(self, world: ArmGripperWorld, way: _Way) -> None:
        # Not in a circle: the engine's memory must go as soon as its world does.
        self._world: ArmGripperWorld = proxy(world)
        self.gripper, self.config, self.way = world.jaws.gripper, way.config, way
        self._height, self._speed = way.height, 0.0

    @property
    def height(self) -> float:
        """Of the gripper over its grasp, along it [m]."""
        return float((self._world.pusher_position - self.way.base) @ self.way.axis)

    def drive(self, height: float, closed: float | None = None) -> None:
        """Advance one step; see `lift.Rig`."""
        world, way, step = self._world, self.way, self.config.physics.time_step
        if closed is not None:
            world.jaws.drive(closed)
        speed = (height - self._height) / step
        pace = float(np.clip((speed - self._speed) / step, -_MOST_ACCELERATION, _MOST_ACCELERATION))
        angles, slope, bend = _along(way.curve, 1 - height / way.height)
        per_metre = -1 / way.height
        world._drive(
            angles, slope * per_metre * speed, bend * (per_metre * speed) ** 2
            + slope * per_metre * pace,
        )  # fmt: skip
        self._height, self._speed = height, speed

    def go(self, height: float, film: list[LiftFrame] | None, phase: str) -> None:
        """Go from rest to rest along the approach."""
        world, start = self._world, self.height
        self._height, self._speed = start, 0.0
        way = abs(height - start)
        steps = self.config.steps(way / self.config.descent_speed)
        for step in range(steps):
            self.drive(start + (height - start) * eased((step + 1) / steps))
            world._shoot(film, phase)

    def stalled(self, travel: float) -> bool:
        """Return whether the fingers stand still short of the travel that they are told [m]."""
        return self._world.jaws.stalled(travel)

    def touched(self, finger: int) -> set[int]:
        """Return the objects that touch one finger."""
        return self._world.jaws.touched(finger, self._world.count)

    def object_poses(self) -> Floats:
        """Return the poses (N, 7) of all objects."""
        return self._world.poses

    def gripper_poses(self) -> Floats:
        """Return the poses (P, 7) of the gripper's rendered parts, and the arm's."""
        return self._world.gripper_poses()

    def unsound(self) -> bool:
        """Return whether the physics went wrong."""
        return is_unsound(self._world._data)


class _RefusedError(Exception):
    """A motion that an arm refuses: the name of the reason."""


def _along(curve: Floats, share: float) -> list[Floats]:
    """Return a polynomial (P, J), its slope and its bend (J,) at a share of the way."""
    return [np.asarray(polyval(share, polyder(curve, n)), np.float64) for n in range(3)]
