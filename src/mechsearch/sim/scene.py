"""Table, end effector and walls, and their compilation with objects for the physics engine."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from mechsearch.grippers import AnyGripper, Cylinder, Gripper
from mechsearch.objects.model import ObjectModel
from mechsearch.sim.arm import WITH_ARM, Arm, add_arm
from mechsearch.sim.gripper import (
    add_gripper,
    add_seal,
    add_servo,
    add_slide,
    add_travelling_cup,
    add_travelling_gripper,
    hold_gripper,
    set_inertia,
)
from mechsearch.types import Array, Floats

AMONG_OBJECTS = 1
"""Bit of what collides with each other: parts of objects, pusher, gripper, walls."""

WITH_TABLE = 2
"""Bit of what rests on the table: one hull of each whole object, which touches a plane where the
union of its parts would, at a fraction of the contacts."""

SLIDING_AND_SPINNING = 4
ROLLING_TOO = 6
"""Friction directions of a contact. Rolling friction acts on the table alone, where balls roll."""


_UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class PhysicsConfig:
    """Numerical choices; `docs/performance.md` tells what each is worth.

    Attributes:
        time_step: [s].
        action_steps: Steps in which the pusher travels its command.
        rest_steps: Steps after that in which it stands, so that every action lasts the same time.
        solver_iterations: At most, for each step.
        contact_time: Time constant with which an overlap of bodies is pushed apart [s]; at least
            two time steps.
        contact_impedance: Share of a contact's force that is hard: at first touch, and from 1 mm
            of overlap.
        sleep_speed: Islands of objects slower than this [m/s] are left out until something touches
            them; 0 simulates everything.
        clearance: Distance between pusher and the nearest convex part [m] down to which it travels
            through a resting heap without the objects being simulated; infinite simulates all.
        still_speed: Speed below which an object lies still [m/s].
        still_spin: Angular speed below which an object lies still [rad/s].
        stops_when_still: Leave out what remains of an action when everything has come to rest.
        deep_penetration: Overlap of two bodies that ends an episode [m].
        explosion_speed: Speed of an object that ends an episode [m/s].
    """

    time_step: float = 0.005
    action_steps: int = 30
    rest_steps: int = 14
    solver_iterations: int = 30
    contact_time: float = 0.01
    contact_impedance: tuple[float, float] = (0.95, 0.99)
    sleep_speed: float = 0.003
    clearance: float = 0.005
    still_speed: float = 0.003
    still_spin: float = 0.05
    stops_when_still: bool = True
    deep_penetration: float = 0.015
    explosion_speed: float = 8.0

    @property
    def steps(self) -> int:
        """Steps of one action."""
        return self.action_steps + self.rest_steps


@dataclass(frozen=True)
class Workspace:
    """A square table at height 0 and the end effector's bounds above it.

    Attributes:
        half: Half the side of the bounds, about the origin [m].
        low: Lowest height of the fingertip [m].
        high: Greatest height of the fingertip [m].
        table_half: Half the side of the table [m].
        floor: Height of the floor around the table [m].
    """

    half: float = 0.3
    low: float = 0.01
    high: float = 0.25
    table_half: float = 0.4
    floor: float = -0.75

    def clip(self, position: Array) -> Floats:
        """Return the nearest position (3,) [m] inside the bounds."""
        low, high = self._bounds
        clipped: Floats = np.minimum(np.maximum(np.asarray(position, np.float64), low), high)
        return clipped

    @cached_property
    def _bounds(self) -> tuple[Floats, Floats]:
        low = np.array([-self.half, -self.half, self.low])
        return low, np.array([self.half, self.half, self.high])

    def sample(self, rng: np.random.Generator) -> Floats:
        """Return a position (3,) [m] drawn uniformly from the bounds."""
        return rng.uniform([-self.half, -self.half, self.low], [self.half, self.half, self.high])

    def off_table(self, positions: Array) -> NDArray[np.bool_]:
        """Return which objects, centres of mass (..., 3) and more, have left the table (...,)."""
        beyond = np.abs(positions[..., :2]).max(axis=-1) > self.table_half
        result: NDArray[np.bool_] = beyond | (positions[..., 2] < -0.05)
        return result


@dataclass(frozen=True)
class Pusher:
    """Geometry and control of the closed fingers. Its position is its lowest point.

    Attributes:
        radius: Of the capsule [m].
        length: From tip to top [m].
        mass: [kg].
        stiffness: Of the position controller [N/m].
        force: Largest force along each axis [N].
        friction: Sliding coefficient.
    """

    radius: float = 0.012
    length: float = 0.2
    mass: float = 0.3
    stiffness: float = 2000.0
    force: float = 25.0
    friction: float = 0.5

    @property
    def outline(self) -> tuple[Cylinder, ...]:
        """What it fills, from the tip upwards."""
        return (Cylinder(self.radius, 0.0, self.length),)

    def pose(self, position: Floats) -> Floats:
        """Return the pose (7,) of the visual model for a tip at `position` (3,)."""
        return np.concatenate([position, _UPRIGHT])


Tool = Pusher | Gripper
"""What an arm holds."""


@cache
def pusher_model(pusher: Pusher, sides: int = 16, rings: int = 4) -> ObjectModel:
    """Return the pusher's mesh for rendering, its origin at the tip."""
    angles = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    lifts = np.linspace(-np.pi / 2, 0, rings + 1)[1:]
    radius, top = pusher.radius, pusher.length
    heights = [radius + radius * np.sin(a) for a in lifts]
    heights += [top - h for h in reversed(heights)]
    radii = [radius * np.cos(a) for a in lifts]
    radii += list(reversed(radii))
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    rows = [
        np.column_stack([circle * r, np.full(sides, h)])
        for r, h in zip(radii, heights, strict=True)
    ]
    vertices = np.concatenate([[[0.0, 0.0, 0.0]], *rows, [[0.0, 0.0, top]]])
    faces: list[tuple[int, int, int]] = []
    last = len(vertices) - 1
    for i in range(sides):
        j = (i + 1) % sides
        faces.append((0, 1 + j, 1 + i))
        for row in range(len(rows) - 1):
            a, b = 1 + row * sides, 1 + (row + 1) * sides
            faces += [(a + i, a + j, b + j), (a + i, b + j, b + i)]
        top_row = 1 + (len(rows) - 1) * sides
        faces.append((top_row + i, top_row + j, last))
    indices = np.array(faces, np.int32)
    texels = np.full((len(indices), 1, 3), (60, 64, 72), np.uint8)
    return ObjectModel(
        "pusher", "robot", vertices, indices, texels, (vertices,), pusher.mass,
        np.eye(3) * 1e-4, pusher.friction, 0.0, "",
    )  # fmt: skip


@dataclass(frozen=True)
class Wall:
    """A vertical cylinder that confines a heap while it drops.

    Attributes:
        x: Centre [m].
        y: Centre [m].
        radius: Inner radius [m].
    """

    x: float
    y: float
    radius: float


def compile_scene(
    models: Sequence[ObjectModel],
    workspace: Workspace,
    pusher: Tool | None,
    walls: Sequence[Wall],
    config: PhysicsConfig,
    gripper: Gripper | None = None,
    travelling: Sequence[AnyGripper] = (),
    arm: Arm | None = None,
    with_fingers: bool = True,
) -> mujoco.MjModel:
    """Return the engine's model: the objects' free joints first, then the robot's own.

    A pusher slides along three axes, or is held by an arm, which may hold a gripper in its place,
    with fingers that move, or stay open.
    """
    spec = mujoco.MjSpec()
    option = spec.option
    option.timestep = config.time_step
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = 10.0
    option.iterations = config.solver_iterations
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    if config.sleep_speed:
        option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)
        option.sleep_tolerance = config.sleep_speed
    for i, model in enumerate(models):
        _add_object(spec, i, model)
    _add_table(spec, workspace)
    if pusher is not None and arm is not None:
        flange = add_arm(spec, arm, AMONG_OBJECTS, WITH_TABLE)
        if isinstance(pusher, Gripper):
            bits = AMONG_OBJECTS | WITH_TABLE | WITH_ARM, AMONG_OBJECTS
            hold_gripper(spec, flange, pusher, *bits, with_fingers)
        else:
            _add_tool(flange, pusher)
    elif isinstance(pusher, Pusher):
        _add_pusher(spec, pusher)
    if gripper is not None:
        add_gripper(spec, gripper, AMONG_OBJECTS, WITH_TABLE)
    for i, own in enumerate(travelling):
        if isinstance(own, Gripper):
            add_travelling_gripper(spec, i, own, AMONG_OBJECTS, WITH_TABLE)
            continue
        add_travelling_cup(spec, i, own, AMONG_OBJECTS)
        for number in range(len(models)):
            add_seal(spec, i, number)
    for i, wall in enumerate(walls):
        _add_wall(spec, i, wall)
    for geom in spec.geoms:
        geom.solref = [config.contact_time, 1.0]
        geom.solimp = [*config.contact_impedance, 0.001, 0.5, 2.0]
    return spec.compile()


def reset_data(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Put a scene back to its start, so that the engine counts warnings without a word.

    It prints and logs a warning of a kind that it has not yet counted in this data.
    """
    mujoco.mj_resetData(model, data)
    data.warning.number[:] = 1


def warned(data: mujoco.MjData) -> bool:
    """Return whether the engine has warned since `reset_data`."""
    return bool((data.warning.number > 1).any())


def _add_table(spec: mujoco.MjSpec, workspace: Workspace) -> None:
    """Add the table's top, without an edge: what crosses the edge has left the scene."""
    geom = spec.worldbody.add_geom()
    geom.name = "table"
    geom.type = mujoco.mjtGeom.mjGEOM_PLANE
    geom.size = [workspace.table_half, workspace.table_half, 1.0]
    geom.friction = [0.6, 0.005, 0.0001]
    geom.condim = ROLLING_TOO
    geom.contype, geom.conaffinity = 0, WITH_TABLE


def _add_object(spec: mujoco.MjSpec, index: int, model: ObjectModel) -> None:
    body = spec.worldbody.add_body()
    body.name = f"object{index}"
    body.pos = [3.0 + index, 0.0, 0.0]
    body.add_freejoint()
    body.mass = model.mass
    inertia = model.inertia
    body.fullinertia = [
        inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2],
    ]  # fmt: skip
    body.ipos = [0.0, 0.0, 0.0]
    body.explicitinertial = True
    single = len(model.parts) == 1
    for k, part in enumerate(model.parts):
        bits = AMONG_OBJECTS | WITH_TABLE if single else AMONG_OBJECTS
        _add_hull(spec, body, f"object{index}part{k}", part, model.friction, bits)
    if not single:
        points = np.concatenate(model.parts)
        whole = points[ConvexHull(points).vertices]
        _add_hull(spec, body, f"object{index}whole", whole, model.friction, WITH_TABLE)


def _add_hull(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, points: Floats, friction: float, bits: int
) -> None:
    mesh = spec.add_mesh()
    mesh.name = name
    mesh.uservert = np.asarray(points, np.float64).ravel().tolist()
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
    geom = body.add_geom()
    geom.type = mujoco.mjtGeom.mjGEOM_MESH
    geom.meshname = name
    geom.friction = [friction, 0.005, 0.001]
    geom.condim = SLIDING_AND_SPINNING
    geom.contype, geom.conaffinity = bits, bits & AMONG_OBJECTS


def _add_pusher(spec: mujoco.MjSpec, pusher: Pusher) -> None:
    body = spec.worldbody.add_body()
    body.name = "pusher"
    set_inertia(body, pusher.mass)
    for name, axis in zip(("pusherx", "pushery", "pusherz"), np.eye(3), strict=True):
        add_slide(body, name, axis)
        limits = (-pusher.force, pusher.force)
        servo = add_servo(spec, name, pusher.stiffness, pusher.mass, limits)
        # An integrated-velocity servo: its set point moves at the commanded velocity.
        servo.dyntype = mujoco.mjtDyn.mjDYN_INTEGRATOR
    _add_fingers(body, pusher, AMONG_OBJECTS)


def _add_tool(flange: mujoco.MjsBody, pusher: Pusher) -> None:
    """Put the pusher into an arm's hand, its z axis back to the flange."""
    body = flange.add_body()
    body.name = "pusher"
    body.pos = [0.0, 0.0, pusher.length]
    body.quat = [0.0, 1.0, 0.0, 0.0]
    # Unlike the free one it can be pressed onto the table.
    _add_fingers(body, pusher, AMONG_OBJECTS | WITH_TABLE | WITH_ARM).mass = pusher.mass
    tip = body.add_site()
    tip.name = "tip"


def _add_fingers(body: mujoco.MjsBody, pusher: Pusher, kind: int) -> mujoco.MjsGeom:
    geom = body.add_geom()
    geom.name = "pusher"
    geom.type = mujoco.mjtGeom.mjGEOM_CAPSULE
    geom.fromto = [0, 0, pusher.radius, 0, 0, pusher.length - pusher.radius]
    geom.size = [pusher.radius, 0, 0]
    geom.friction = [pusher.friction, 0.005, 0.0001]
    geom.condim = SLIDING_AND_SPINNING
    geom.contype, geom.conaffinity = kind, AMONG_OBJECTS
    return geom


def _add_wall(spec: mujoco.MjSpec, index: int, wall: Wall, sides: int = 16) -> None:
    body = spec.worldbody.add_body()
    body.name = f"wall{index}"
    body.mocap = True
    body.pos = [wall.x, wall.y, 0.0]
    middle = wall.radius + 0.01
    half_width = 1.1 * (middle + 0.01) * np.tan(np.pi / sides)
    for i in range(sides):
        angle = 2 * np.pi * i / sides
        geom = body.add_geom()
        geom.type = mujoco.mjtGeom.mjGEOM_BOX
        geom.size = [0.01, half_width, 0.5]
        geom.pos = [middle * np.cos(angle), middle * np.sin(angle), 0.5]
        geom.quat = [np.cos(angle / 2), 0, 0, np.sin(angle / 2)]
        geom.friction = [0.05, 0.005, 0.0001]
        geom.priority = 1
