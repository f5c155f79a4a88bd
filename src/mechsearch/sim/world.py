"""The physics engine: the only module that imports it."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from mechsearch.geometry import rotation_from_quaternion
from mechsearch.objects.model import ObjectModel
from mechsearch.sim.pusher import Pusher
from mechsearch.sim.workspace import Workspace
from mechsearch.types import Array, Floats

ENGINE_VERSION = str(mujoco.__version__)
_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
_AWAY = np.array([0.0, 0.0, 5.0])


@dataclass(frozen=True)
class PhysicsConfig:
    """Numerical choices.

    Attributes:
        time_step: [s].
        action_steps: Steps in which the pusher travels its command.
        rest_steps: Steps after that in which it stands, so that every action lasts the same time.
        solver_iterations: At most, for each step.
        deep_penetration: Overlap of two bodies that ends an episode [m].
        explosion_speed: Speed of an object that ends an episode [m/s].
        clearance: Distance from the pusher's way to every object's bounding box [m] from which an
            action need not be simulated, if the heap lies still.
        still_speed: Speed below which an object lies still [m/s].
        still_spin: Angular speed below which an object lies still [rad/s].
    """

    time_step: float = 0.005
    action_steps: int = 30
    rest_steps: int = 14
    solver_iterations: int = 30
    deep_penetration: float = 0.015
    explosion_speed: float = 8.0
    clearance: float = 0.005
    still_speed: float = 0.003
    still_spin: float = 0.05


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


class World:
    """Objects on a table, and a pusher or a confining wall."""

    def __init__(
        self,
        models: Sequence[ObjectModel],
        workspace: Workspace | None = None,
        pusher: Pusher | None = None,
        walls: Sequence[Wall] = (),
        config: PhysicsConfig | None = None,
    ) -> None:
        """Compile a scene.

        Args:
            models: The objects, in the order of all poses.
            workspace: Table and bounds.
            pusher: The end effector, or None for a world without one.
            walls: Confining walls.
            config: Numerical choices.
        """
        self.config = config or PhysicsConfig()
        self.workspace = workspace or Workspace()
        self.count = len(models)
        self._pusher = pusher
        self._points = [np.concatenate(model.parts) for model in models]
        self._model = _compile(models, self.workspace, pusher, walls, self.config)
        self._data = mujoco.MjData(self._model)
        self._size = mujoco.mj_stateSize(self._model, _STATE)
        self._pusher_geom = mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_GEOM, "pusher")
        self._table_geom = mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_GEOM, "table")
        self._tip = self._data.qpos[7 * self.count :]

    @property
    def poses(self) -> Floats:
        """Poses (N, 7) of all objects."""
        return np.array(self._data.qpos[: 7 * self.count]).reshape(-1, 7)

    @property
    def velocities(self) -> Floats:
        """Linear and angular velocities (N, 6) of all objects [m/s, rad/s]."""
        return np.array(self._data.qvel[: 6 * self.count]).reshape(-1, 6)

    @property
    def pusher_position(self) -> Floats:
        """Position (3,) of the fingertip [m]."""
        return np.array(self._tip)

    def reset(self, poses: Array, pusher_position: Array | None = None) -> None:
        """Put all objects at rest at `poses` (N, 7), and the pusher where it is told."""
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[: 7 * self.count] = np.asarray(poses, np.float64).ravel()
        if self._pusher is not None:
            self.place_pusher(_AWAY if pusher_position is None else pusher_position)

    def place(self, index: int, pose: Array) -> None:
        """Put one object at rest at a pose (7,)."""
        self._data.qpos[7 * index : 7 * index + 7] = pose
        self._data.qvel[6 * index : 6 * index + 6] = 0.0

    def place_pusher(self, position: Array) -> None:
        """Put the pusher at rest at a position (3,) [m]."""
        self._tip[:] = position
        self._data.qvel[6 * self.count :] = 0.0
        self._data.act[:] = position
        self._data.ctrl[:] = 0.0

    def pusher_is_free(self) -> bool:
        """Return whether nothing touches the pusher where it stands."""
        mujoco.mj_forward(self._model, self._data)
        pairs = self._data.contact.geom[: self._data.ncon]
        return not bool((pairs == self._pusher_geom).any())

    def remove_walls(self) -> None:
        """Take the confining walls away."""
        self._data.mocap_pos[:, 2] = -20.0

    def step(self, steps: int) -> None:
        """Advance by a number of time steps."""
        mujoco.mj_step(self._model, self._data, steps)

    def push(self, target: Array) -> None:
        """Move the fingertip towards `target` (3,) [m]: one action's worth of simulated time.

        Where the heap lies still and the way is clear of every object's bounding box, the pusher
        travels exactly and the objects stay exactly: there is nothing to simulate.
        """
        config, goal = self.config, np.asarray(target, np.float64)
        if self._passes_freely(goal):
            self.place_pusher(goal)
            self._data.time += (config.action_steps + config.rest_steps) * config.time_step
            return
        position = self.pusher_position
        self._data.act[:] = position
        self._data.ctrl[:] = (goal - position) / (config.action_steps * config.time_step)
        mujoco.mj_step(self._model, self._data, config.action_steps)
        self._data.ctrl[:] = 0.0
        mujoco.mj_step(self._model, self._data, config.rest_steps)

    def _passes_freely(self, target: Floats) -> bool:
        assert self._pusher is not None
        speeds = np.abs(self.velocities).max(axis=0, initial=0.0)
        if not (
            speeds[:3].max() < self.config.still_speed and speeds[3:].max() < self.config.still_spin
        ):
            return False
        ends = np.stack([self.pusher_position, target])
        reach = self._pusher.radius + self.config.clearance
        low = ends.min(axis=0) - np.array([reach, reach, self.config.clearance])
        top = self._pusher.length + self.config.clearance
        high = ends.max(axis=0) + np.array([reach, reach, top])
        if low[2] < 0.0:
            return False
        poses = self.poses
        for rotation, pose, points in zip(
            rotation_from_quaternion(poses[:, 3:]), poses, self._points, strict=True
        ):
            corners = points @ rotation.T + pose[:3]
            if (corners.max(axis=0) > low).all() and (corners.min(axis=0) < high).all():
                return False
        return True

    def penetrations(self) -> Floats:
        """Return the overlap (C,) of every contact [m], in the last computed step."""
        distances: Floats = np.array(self._data.contact.dist[: self._data.ncon], np.float64)
        return np.maximum(-distances, 0.0)

    def failure(self) -> str | None:
        """Return the name of a simulator failure, or None while physics can be trusted."""
        data = self._data
        if not (np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()):
            return "not a number"
        if data.warning.number[: int(mujoco.mjtWarning.mjNWARNING)].any():
            return "solver warning"
        poses, speeds = self.poses, np.linalg.norm(self.velocities[:, :3], axis=1)
        on_table = np.abs(poses[:, :2]).max(axis=1) < self.workspace.table_half - 0.05
        if (on_table & (poses[:, 2] < -0.01)).any():
            return "tunnelling"
        if (on_table & (speeds > self.config.explosion_speed)).any():
            return "explosion"
        if self.penetrations().max(initial=0.0) > self.config.deep_penetration:
            return "deep penetration"
        return None

    def snapshot(self) -> Floats:
        """Return all that the next step depends on; `restore` continues bit by bit."""
        state = np.empty(self._size)
        mujoco.mj_getState(self._model, self._data, state, _STATE)
        return state

    def restore(self, state: Array) -> None:
        """Return to a snapshot of this world."""
        mujoco.mj_setState(self._model, self._data, np.asarray(state, np.float64), _STATE)
        for warning in range(int(mujoco.mjtWarning.mjNWARNING)):
            self._data.warning.number[warning] = 0

    def cast(self, origin: Array, directions: Array) -> tuple[Floats, Array]:
        """Cast rays (K, 3) from one origin with the engine: distances, and object indices (-1).

        The engine is slow at this; it is here to check the renderer.
        """
        mujoco.mj_forward(self._model, self._data)
        unit = np.asarray(directions, np.float64)
        lengths = np.linalg.norm(unit, axis=1)
        geoms = np.full(len(unit), -1, np.int32)
        distances = np.full(len(unit), -1.0)
        mujoco.mj_multiRay(
            self._model, self._data, np.asarray(origin, np.float64),
            np.ascontiguousarray(unit / lengths[:, None]).ravel(), None, True, -1, geoms,
            distances, None, len(unit), 100.0,
        )  # fmt: skip
        bodies = np.where(geoms >= 0, self._model.geom_bodyid[geoms], 0)
        objects = np.where((bodies >= 1) & (bodies <= self.count), bodies - 1, -1)
        return distances / lengths, objects


def _compile(
    models: Sequence[ObjectModel],
    workspace: Workspace,
    pusher: Pusher | None,
    walls: Sequence[Wall],
    config: PhysicsConfig,
) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    option = spec.option
    option.timestep = config.time_step
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = 10.0
    option.iterations = config.solver_iterations
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    for i, model in enumerate(models):
        _add_object(spec, i, model)
    table = spec.worldbody.add_geom()
    table.name = "table"
    table.type = mujoco.mjtGeom.mjGEOM_BOX
    table.size = [workspace.table_half, workspace.table_half, 0.1]
    table.pos = [0.0, 0.0, -0.1]
    table.friction = [0.6, 0.005, 0.0001]
    floor = spec.worldbody.add_geom()
    floor.type = mujoco.mjtGeom.mjGEOM_PLANE
    floor.size = [0.0, 0.0, 1.0]
    floor.pos = [0.0, 0.0, workspace.floor]
    if pusher is not None:
        _add_pusher(spec, pusher)
    for i, wall in enumerate(walls):
        _add_wall(spec, i, wall)
    return spec.compile()


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
    for k, part in enumerate(model.parts):
        mesh = spec.add_mesh()
        mesh.name = f"object{index}part{k}"
        mesh.uservert = np.asarray(part, np.float64).ravel().tolist()
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
        geom = body.add_geom()
        geom.type = mujoco.mjtGeom.mjGEOM_MESH
        geom.meshname = mesh.name
        geom.friction = [model.friction, 0.005, 0.001]
        geom.condim = 6


def _add_pusher(spec: mujoco.MjSpec, pusher: Pusher) -> None:
    body = spec.worldbody.add_body()
    body.name = "pusher"
    body.gravcomp = 1.0
    body.mass = pusher.mass
    body.inertia = [1e-3, 1e-3, 1e-3]
    body.explicitinertial = True
    for axis in range(3):
        joint = body.add_joint()
        joint.name = f"pusher{'xyz'[axis]}"
        joint.type = mujoco.mjtJoint.mjJNT_SLIDE
        joint.axis = np.eye(3)[axis]
        actuator = spec.add_actuator()
        actuator.name = joint.name
        actuator.target = joint.name
        actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
        # An integrated-velocity servo: its set point moves at the commanded velocity.
        actuator.dyntype = mujoco.mjtDyn.mjDYN_INTEGRATOR
        actuator.gaintype = mujoco.mjtGain.mjGAIN_FIXED
        actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        actuator.gainprm[0] = pusher.stiffness
        actuator.biasprm[1] = -pusher.stiffness
        actuator.biasprm[2] = -pusher.damping
        actuator.forcelimited = True
        actuator.forcerange = [-pusher.force, pusher.force]
    geom = body.add_geom()
    geom.name = "pusher"
    geom.type = mujoco.mjtGeom.mjGEOM_CAPSULE
    geom.fromto = [0, 0, pusher.radius, 0, 0, pusher.length - pusher.radius]
    geom.size = [pusher.radius, 0, 0]
    geom.friction = [pusher.friction, 0.005, 0.0001]


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
