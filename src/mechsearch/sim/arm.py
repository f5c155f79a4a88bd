"""Robot arms as data, from what their makers publish, and how an arm is added to a scene.

Kinematics are in Craig's modified Denavit-Hartenberg convention: a joint turns about the z axis of
its frame, which lies at Rx(alpha) Tx(a) Tz(d) in the frame before it. An arm's shape is capsules.
"""

from dataclasses import dataclass
from math import cos, pi, sin
from typing import NamedTuple

import mujoco
import numpy as np

from mechsearch.types import Floats, MechSearchError

FREE = "free"
"""Names the pusher that no arm carries."""

OUT_OF_REACH = "out of reach"
JOINT_LIMIT = "joint limit"
SELF_COLLISION = "self-collision"
TABLE = "table"
SINGULARITY = "singularity"
REFUSED = (OUT_OF_REACH, JOINT_LIMIT, SELF_COLLISION, TABLE, SINGULARITY)
"""Names of the reasons for which a motion is refused before it begins."""

_ROTOR_INERTIA = 0.1
"""Of a geared motor, as its joint feels it [kg m^2]: no maker publishes it; this is the value that
models of both arms in use assume."""

WITH_ARM = 4
"""Bit of what the parts of an arm collide with."""

_FRICTION = 0.5
"""Sliding coefficient of links."""


class Capsule(NamedTuple):
    """What a link fills: all within `radius` of the line between two points of its frame [m]."""

    start: tuple[float, float, float]
    end: tuple[float, float, float]
    radius: float


@dataclass(frozen=True)
class Link:
    """A joint, and the link that it turns.

    Attributes:
        a: Along x to the joint [m].
        alpha: About x to its axis [rad].
        d: Along its axis [m].
        low: Least angle [rad].
        high: Greatest angle [rad].
        velocity: Largest [rad/s].
        torque: Largest [N m].
        mass: [kg].
        capsules: Of the link, in its own frame.
    """

    a: float
    alpha: float
    d: float
    low: float
    high: float
    velocity: float
    torque: float
    mass: float
    capsules: tuple[Capsule, ...]


@dataclass(frozen=True)
class Arm:
    """A robot arm and where it stands.

    Attributes:
        name: Under which it is chosen.
        links: From the base to the wrist.
        flange: From the last frame along its z axis [m].
        foot: What does not move, in the base's frame.
        base: Where the base stands in the workspace's axes [m].
        yaw: How far it is turned about z [rad].
        home: Joint angles with the tool straight down over the middle of the table [rad].
    """

    name: str
    links: tuple[Link, ...]
    flange: float
    foot: Capsule
    base: tuple[float, float, float]
    yaw: float
    home: tuple[float, ...]

    def of_joints(self, field: str) -> Floats:
        """Return one attribute of all links, such as "torque" (J,)."""
        return np.array([getattr(link, field) for link in self.links])


@dataclass(frozen=True)
class ArmMotion:
    """What an arm did in one action, or why it refused.

    Attributes:
        refusal: Name of the reason why it did not move, one of `REFUSED`, or None.
        duration: [s].
        velocities: Each joint's largest, as a share of its limit (J,).
        torques: The largest that control asked of each joint, as a share of its limit (J,), and
            never more than that.
        margin: Least distance of a joint from the end of its way [rad].
        touched: What links met, of "heap", "table" and "itself"; the tool may meet the heap.
    """

    refusal: str | None
    duration: float
    velocities: Floats
    torques: Floats
    margin: float
    touched: tuple[str, ...] = ()


def _ur(
    a: float,
    alpha: float,
    d: float,
    torque: float,
    mass: float,
    *capsules: Capsule,
    turn: float = 2 * pi,
) -> Link:
    """Return a joint of a UR5e, all of which are as fast, and turn once both ways but the elbow."""
    return Link(a, alpha, d, -turn, turn, pi, torque, mass, capsules)


# Kinematics and masses: Universal Robots, "DH parameters for calculations of kinematics and
# dynamics"; angles and velocities: user manual of the UR5e; torques: "Max. joint torques". The
# elbow turns half around, beyond which the shoulder is in its way. Upper arm and forearm lie beside
# the lines between joints, as the published centres of mass show.
UR5E = Arm(
    "ur5e",
    (
        _ur(0.0, 0.0, 0.1625, 150.0, 3.761, Capsule((0, 0, -0.05), (0, 0, 0), 0.06)),
        _ur(0.0, pi / 2, 0.0, 150.0, 8.058, Capsule((0, 0, 0), (0, 0, 0.138), 0.06),
            Capsule((0, 0, 0.138), (-0.425, 0, 0.138), 0.055)),
        _ur(-0.425, 0.0, 0.0, 150.0, 2.846, Capsule((0, 0, 0.138), (0, 0, 0.007), 0.055),
            Capsule((0, 0, 0.007), (-0.3922, 0, 0.007), 0.045), turn=pi),
        _ur(-0.3922, 0.0, 0.1333, 28.0, 1.37, Capsule((0, 0, -0.12), (0, 0, 0), 0.045)),
        _ur(0.0, pi / 2, 0.0997, 28.0, 1.3, Capsule((0, 0, -0.0997), (0, 0, 0), 0.045)),
        _ur(0.0, -pi / 2, 0.0996, 28.0, 0.365, Capsule((0, 0, -0.0996), (0, 0, -0.04), 0.04)),
    ),
    0.0,
    Capsule((0, 0, -0.06), (0, 0, 0.03), 0.06),
    (-0.48, 0.0, 0.05),
    pi,
    (-0.27, -1.57, 1.8, -1.8, -pi / 2, 0.0),
)  # fmt: skip

# Kinematics, angles, velocities, torques: Franka Emika, "Robot and interface specifications";
# capsules: its description for self-collision; masses, which it does not publish: C. Gaz et al.,
# "Dynamic identification of the Franka Emika Panda robot", RA-L 2019.
PANDA = Arm(
    "panda",
    (
        Link(0.0, 0.0, 0.333, -2.8973, 2.8973, 2.175, 87.0, 4.970684,
             (Capsule((0, 0, -0.333), (0, 0, -0.05), 0.06),)),
        Link(0.0, -pi / 2, 0.0, -1.7628, 1.7628, 2.175, 87.0, 0.646926,
             (Capsule((0, 0, -0.06), (0, 0, 0.06), 0.06),)),
        Link(0.0, pi / 2, 0.316, -2.8973, 2.8973, 2.175, 87.0, 3.228604,
             (Capsule((0, 0, -0.22), (0, 0, -0.07), 0.06),)),
        Link(0.0825, pi / 2, 0.0, -3.0718, -0.0698, 2.175, 87.0, 3.587895,
             (Capsule((0, 0, -0.06), (0, 0, 0.06), 0.06),)),
        Link(-0.0825, -pi / 2, 0.384, -2.8973, 2.8973, 2.61, 12.0, 1.225946,
             (Capsule((0, 0, -0.31), (0, 0, -0.21), 0.06),
              Capsule((0, 0.08, -0.2), (0, 0.08, -0.06), 0.025))),
        Link(0.0, pi / 2, 0.0, -0.0175, 3.7525, 2.61, 12.0, 1.666555,
             (Capsule((0, 0, -0.07), (0, 0, 0.01), 0.05),)),
        Link(0.088, pi / 2, 0.0, -2.8973, 2.8973, 2.61, 12.0, 0.735522,
             (Capsule((0, 0, -0.06), (0, 0, 0.06), 0.04),
              Capsule((0.055, 0, 0.082), (0.065, 0, 0.082), 0.03))),
    ),
    0.107,
    Capsule((-0.09, 0, 0.06), (-0.06, 0, 0.06), 0.06),
    (-0.46, 0.0, 0.1),
    0.0,
    (0.0, -0.4, 0.0, -2.4, 0.0, 2.0, 0.0),
)  # fmt: skip

ARMS = {arm.name: arm for arm in (UR5E, PANDA)}


def arm_named(name: str) -> Arm | None:
    """Return an arm by name; None for the free pusher.

    Raises:
        MechSearchError: If there is no such robot.
    """
    if name != FREE and name not in ARMS:
        raise MechSearchError(f"unknown robot {name!r}; choose one of {', '.join((FREE, *ARMS))}")
    return ARMS.get(name)


def add_arm(spec: mujoco.MjSpec, arm: Arm, among: int, with_table: int) -> mujoco.MjsBody:
    """Add an arm to a scene, and return the body of its flange, z away from the arm.

    Foot and first link turn on a spot beside the table, over which heaps may hang that were dropped
    without an arm: they meet the arm alone.

    Args:
        spec: The scene.
        arm: The arm.
        among: Bit of what collides with objects.
        with_table: Bit of what rests on the table.
    """
    spec.compiler.degree = False
    body = spec.worldbody.add_body()
    body.name = "base"
    body.pos = arm.base
    body.quat = [cos(arm.yaw / 2), 0.0, 0.0, sin(arm.yaw / 2)]
    _add_capsule(body, arm.foot, WITH_ARM, WITH_ARM)
    for number, link in enumerate(arm.links):
        body = body.add_body()
        body.name = f"link{number}"
        body.pos = [link.a, -sin(link.alpha) * link.d, cos(link.alpha) * link.d]
        body.quat = [cos(link.alpha / 2), sin(link.alpha / 2), 0.0, 0.0]
        joint = body.add_joint()
        joint.name = f"joint{number}"
        joint.axis = [0.0, 0.0, 1.0]
        joint.limited = True
        joint.range = [link.low, link.high]
        joint.armature = _ROTOR_INERTIA
        whole = sum(map(_volume, link.capsules))
        meets = among | WITH_ARM if number else WITH_ARM
        for capsule in link.capsules:
            geom = _add_capsule(body, capsule, meets | with_table, meets)
            geom.mass = link.mass * _volume(capsule) / whole
        motor = spec.add_actuator()
        motor.name = motor.target = joint.name
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
        motor.forcelimited = True
        motor.forcerange = [-link.torque, link.torque]
    # The first link turns on the spot where it stands.
    for still in ("base", "world"):
        exclude = spec.add_exclude()
        exclude.bodyname1, exclude.bodyname2 = still, "link0"
    flange = body.add_body()
    flange.name = "flange"
    flange.pos = [0.0, 0.0, arm.flange]
    return flange


def _add_capsule(
    body: mujoco.MjsBody, capsule: Capsule, kind: int, affinity: int
) -> mujoco.MjsGeom:
    geom = body.add_geom()
    geom.type = mujoco.mjtGeom.mjGEOM_CAPSULE
    geom.fromto = [*capsule.start, *capsule.end]
    geom.size = [capsule.radius, 0, 0]
    geom.friction = [_FRICTION, 0.005, 0.0001]
    geom.contype, geom.conaffinity = kind, affinity
    return geom


def _volume(capsule: Capsule) -> float:
    length = float(np.linalg.norm(np.subtract(capsule.end, capsule.start)))
    return pi * capsule.radius**2 * (length + 4 / 3 * capsule.radius)
