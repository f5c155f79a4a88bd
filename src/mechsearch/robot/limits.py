"""What a robot may do whatever it is told: limits, and the guard in its driver that keeps them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import dist, inf, isfinite
from typing import Any

import numpy as np

from mechsearch.geometry import cap_length, rotation_from_quaternion
from mechsearch.types import Array, Floats, MechSearchError, finite_numbers

MOVE, RETREAT, STOP, GRASPING = "move", "retreat", "stop", "grasp"
"""Kinds of motions."""

APPROACH = 0.1
"""How far before a grasp its straight approach begins [m]."""

_OUTSIDE = 1e-6
"""How far outside of the box a grasp may be [m]: as numbers are rounded on their way."""

_NEAR = 0.005
"""How far from a place on its way to a grasp the tip may be to go on [m]."""

_MARGIN = 0.8
"""Share of speed and force at which the guard stays or stops: reactions take time."""

_SLOWING = 0.1
"""Time in which a motion comes to rest at its goal [s]."""


@dataclass(frozen=True)
class Limits:
    """What is never exceeded, in the robot's base frame.

    Attributes:
        low: Lowest corner (3,) of the box that the tool's tip stays in [m].
        high: Highest corner (3,) [m].
        speed: Of the tip [m/s].
        force: At the tool [N]. It grows by the robot's stiffness times its speed until the driver
            reacts: stiff robots must go slowly.
        lag: How far the set point may be ahead of the tip, as the time at full speed [s]: what
            bounds the force of a push, and how fast the tool sets off when what blocks it gives
            way. As long as the robot takes to follow, or it is slower.
        image_age: Of an image when it is decided on [s].
        watchdog: Between two commands, and between two measurements of the tool [s].
        camera_shift: How far a camera may move from where it was at first [m].
        camera_turn: How far it may turn [degrees].
        lost_looks: Decisions in a row at which no target is seen, after which to stop; None leaves
            it to the policy: 5, or an episode's 50 of one that searches.
        retreat: How far up to go after a refusal [m].
        reach: How far the tip gets from the base's origin, as a robot's data sheet says [m]. The
            whole box must be within it.
        joints: Ranges of the robot's joints [rad] by their names, which are then to be measured.
        joint_margin: How far a joint stays from both ends of its range [rad].
        dry_run: Whether to decide all, and move nothing.
    """

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    speed: float = 0.1
    force: float = 20.0
    lag: float = 0.025
    image_age: float = 0.3
    watchdog: float = 0.3
    camera_shift: float = 0.01
    camera_turn: float = 2.0
    lost_looks: int | None = None
    retreat: float = 0.1
    reach: float = inf
    joints: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    joint_margin: float = 0.05
    dry_run: bool = False

    def __post_init__(self) -> None:
        for name in ("low", "high"):
            finite_numbers(getattr(self, name), (3,), f"{name} is a corner (3,) [m]")
        if not np.less(self.low, self.high).all():
            raise MechSearchError(
                f"the box from {self.low} to {self.high} m is empty; expected low below high"
            )
        names = ("speed", "force", "lag", "image_age", "watchdog", "camera_shift", "camera_turn")
        lost = () if self.lost_looks is None else ("lost_looks",)
        for name in (*names, *lost, "retreat", "joint_margin"):
            value = getattr(self, name)
            if not (isfinite(value) and value > 0):
                raise MechSearchError(f"{name} is {value}; expected a finite number above 0")
        for name, ends in self.joints.items():
            low, high = finite_numbers(ends, (2,), f"joint {name} has two ends [rad]")
            if not low + 2 * self.joint_margin < high:
                raise MechSearchError(
                    f"joint {name} goes from {low} to {high} rad; expected more than twice the "
                    f"margin of {self.joint_margin} rad"
                )
        farthest = np.abs([self.low, self.high]).max(axis=0)
        if not (away := dist(farthest, (0, 0, 0))) <= self.reach:
            raise MechSearchError(
                f"the box from {self.low} to {self.high} m lies up to {away:.3f} m from the base, "
                f"out of its reach of {self.reach} m"
            )

    def clip(self, position: Array) -> Floats:
        """Return the nearest position (3,) [m] in the box."""
        return np.clip(np.asarray(position, np.float64), self.low, self.high)

    def outside(self, position: Array) -> float:
        """Return how far a position (3,) is outside of the box [m]."""
        return float(np.abs(position - self.clip(position)).max())

    def ends_of_joints(self, tool: "Tool", share: float = 1.0) -> str:
        """Return in words which joint was not measured, or is at an end of its range; or nothing.

        Args:
            tool: As it is measured.
            share: What the margin is divided by: who takes a while to react begins earlier.
        """
        for name, (low, high) in self.joints.items():
            angle = tool.joints.get(name, np.nan)
            if not isfinite(angle):
                return f"joint {name} is not measured"
            if min(angle - low, high - angle) < self.joint_margin / share:
                return (
                    f"joint {name} is at {angle:.3f} rad; expected {self.joint_margin} rad from "
                    f"its ends at {low} and {high}"
                )
        return ""

    def beyond(self, grasp: "PlannedGrasp") -> str:
        """Return in words how far a grasp, or where it begins, is outside of the box; or nothing.

        A grasp is not moved to the border: elsewhere it is another one.
        """
        away = max(self.outside(grasp.position), self.outside(grasp.begin))
        if away <= _OUTSIDE:
            return ""
        place = ", ".join(f"{number:.3f}" for number in grasp.position)
        return f"the grasp at ({place}) m is, or begins, {away:.3f} m outside the box of the limits"

    def way_to(self, grasp: "PlannedGrasp", position: Array) -> list[Floats]:
        """Return where the tip passes (3,) [m] from a position to a grasp, and the grasp.

        It rises to the top of the box, goes over the beginning of the approach and down to it, and
        then along the approach. What is behind is left out.
        """
        begin, top = grasp.begin, self.high[2]
        over = np.array([*begin[:2], top])
        before = begin - grasp.position
        along = float((position - grasp.position) @ before) / APPROACH
        aside = position - grasp.position - along * before / APPROACH
        if np.linalg.norm(aside) < _NEAR and along < APPROACH + _NEAR:
            return [grasp.position]
        if np.linalg.norm(position[:2] - begin[:2]) < _NEAR:
            return [begin, grasp.position]
        if position[2] > top - _NEAR:
            return [over, begin, grasp.position]
        return [np.array([*position[:2], top]), over, begin, grasp.position]

    def above(self, tool: "Tool") -> Floats | None:
        """Return where to retreat to (3,) [m], or None where going up is not safe.

        It is not where something presses on the tool from above, or the tool is outside the box.
        """
        if self.outside(tool.position) > 0.01 or tool.force[2] < -_MARGIN * self.force / 2:
            return None
        return self.clip(np.add(tool.position, (0.0, 0.0, self.retreat)))


@dataclass(frozen=True)
class Tool:
    """The tool as the robot measures it, in its base frame.

    Attributes:
        position: Of the tip (3,) [m].
        time: When it was measured [s].
        force: That acts on it from outside (3,) [N].
        joints: Of the robot [rad], by name; at least those of the limits.
        ready: Whether it is turned and open as the grasp asks that is being made; before, no guard
            lets it come down.
    """

    position: Floats
    time: float
    force: Floats = field(default_factory=lambda: np.zeros(3))
    joints: Mapping[str, float] = field(default_factory=dict)
    ready: bool = False


@dataclass(frozen=True, eq=False)
class PlannedGrasp:
    """A grasp in the robot's base frame.

    Attributes:
        position: Of the tool's tip when it closes (3,) [m]: between the ends of the open fingers,
            or in the middle of a cup's lip.
        quaternion: Of the tool's axes (4,), scalar first: x along the closing direction, z against
            the approach, up where that is straight down.
        opening: Between the fingers before they close [m]; 0 of a cup.
        quality: Chance that it lifts the target, in [0, 1].
        gripper: By name.
    """

    position: Floats
    quaternion: Floats
    opening: float
    quality: float
    gripper: str

    @property
    def axes(self) -> Floats:
        """The tool's axes as columns (3, 3)."""
        return rotation_from_quaternion(self.quaternion)

    @property
    def approach(self) -> Floats:
        """Direction (3,) in which the tool comes."""
        return -self.axes[:, 2]

    @property
    def begin(self) -> Floats:
        """Where the tip is when the straight approach begins (3,) [m]."""
        return np.asarray(self.position - APPROACH * self.approach)


@dataclass(frozen=True)
class Motion:
    """A command: a straight motion of the tip in the robot's base frame, a grasp, or none.

    Attributes:
        kind: "move", "retreat", "stop" or "grasp".
        goal: Where the tip goes (3,) [m]; where it is, of a stop.
        speed: At most [m/s].
        time: When it was commanded [s].
        reason: In words.
        confidence: Of the policy, in [0, 1], or None; see `robot.policy.Choice`.
        expects: What it expects; see there, and `robot.grasper.GraspExpectation`.
        grasp: How the tool comes, of a grasp; else None.
    """

    kind: str
    goal: Floats
    speed: float
    time: float
    reason: str
    confidence: float | None = None
    expects: Any = None
    grasp: PlannedGrasp | None = None


class Guard:
    """Turns motions into set points within the limits; it runs in the robot's driver.

    It trusts nobody: neither that motions keep the limits, nor that another one comes. After a
    refusal it retreats or stands, until a new one is made.

    Attributes:
        refusal: Why it has stopped; empty while it has not.
    """

    def __init__(self, limits: Limits) -> None:
        """Keep some limits; there is no motion yet."""
        self.limits, self.refusal = limits, ""
        self._motion: Motion | None = None
        self._heard = self._ticked = -np.inf
        self._point: Floats | None = None

    def receive(self, motion: Motion, now: float) -> None:
        """Take a motion that has arrived at a time [s]."""
        if self.refusal:
            return
        grasp, kinds = motion.grasp, (MOVE, RETREAT, STOP) if motion.grasp is None else (GRASPING,)
        numbers = [*motion.goal, motion.speed, *([] if grasp is None else grasp.position)]
        whole = np.isfinite(numbers).all() and motion.speed > 0
        if grasp is not None:
            whole &= abs(float(np.linalg.norm(grasp.quaternion)) - 1) < _OUTSIDE
        if motion.kind not in kinds or not whole:
            told = f"{motion.kind} to {motion.goal} at {motion.speed} m/s"
            self.refusal, self._motion = f"no motion: {told}", None
            return
        if grasp is not None and (beyond := self.limits.beyond(grasp)):
            self.refusal, self._motion = beyond, None
            return
        if motion.kind == STOP and (self._motion is None or self._motion.kind != STOP):
            self._point = None
        self._motion, self._heard = motion, now

    def set_point(self, tool: Tool, now: float, stop: bool = False) -> Floats:
        """Return where the tip should be next (3,) [m].

        Args:
            tool: As it is measured now.
            now: [s], of the same clock; called at the robot's own rate.
            stop: Whether somebody presses the stop.
        """
        limits, position = self.limits, np.asarray(tool.position, np.float64)
        tick = min(max(now - self._ticked, 0.0), 0.02)
        self._ticked = now
        self._check(tool, now, stop)
        if self._point is None:
            self._point = position.copy()
        motion = self._motion
        if limits.dry_run or motion is None or motion.kind == STOP:
            return self._point
        speed = _MARGIN * min(motion.speed, limits.speed)
        ahead = limits.clip(self._next(motion, tool)) - self._point
        ahead = cap_length(
            ahead, speed * tick * min(1.0, float(np.linalg.norm(ahead)) / (speed * _SLOWING))
        )
        self._point = position + cap_length(
            self._point + ahead - position, limits.lag * limits.speed
        )
        return self._point

    def _next(self, motion: Motion, tool: Tool) -> Array:
        """Return where a motion passes next (3,) [m]; the last set point, while it has to wait."""
        if motion.grasp is None:
            return motion.goal
        way = self.limits.way_to(motion.grasp, tool.position)
        waits = len(way) == 1 and not tool.ready
        return self._point if waits and self._point is not None else way[0]

    def _check(self, tool: Tool, now: float, stop: bool) -> None:
        limits, moving = self.limits, self._motion is not None and self._motion.kind != STOP
        force = float(np.linalg.norm(tool.force))
        pressed = force > _MARGIN * limits.force
        if stop:
            self._refuse("the stop is pressed", None)
        elif now - tool.time > limits.watchdog or not np.isfinite(tool.position).all():
            self._refuse(f"no measurement of the tool for {now - tool.time:.2f} s", None)
        elif end := limits.ends_of_joints(tool, _MARGIN):
            # Up may be where that joint is at its end.
            self._refuse(end, None)
        elif pressed and (not self.refusal or (moving and force > limits.force)):
            # What acts already may act while going up, but not grow.
            again = bool(self.refusal)
            self._refuse(f"{force:.1f} N at the tool", None if again else tool)
        elif not self.refusal and moving and now - self._heard > limits.watchdog:
            self._refuse(f"no command for {now - self._heard:.2f} s", tool)

    def _refuse(self, reason: str, retreats: Tool | None) -> None:
        """Stop, and go up from where the tool is if one is given and it is safe."""
        self.refusal = self.refusal or reason
        goal = None if retreats is None else self.limits.above(retreats)
        if goal is not None and retreats is not None:
            self._point = np.array(retreats.position, np.float64)
            self._motion = Motion(RETREAT, goal, self.limits.speed, retreats.time, reason)
        elif self._motion is not None:
            self._motion, self._point = None, None
