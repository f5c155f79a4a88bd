"""The paper's stack as a peer: PyBullet at 240 Hz with 50 solver iterations.

Same hulls, masses, inertia, table, pusher and simulated time as ours. Bullet multiplies the
friction of two bodies where ours takes the larger, so the coefficients are chosen to give the same
friction in every contact. Rolling and torsional friction are left out: they would cost Bullet
another 40 %.
"""

import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import pybullet
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from mechsearch.env.heap_env import HeapEnvConfig
from mechsearch.geometry import quaternion_product, rotation_from_quaternion
from mechsearch.objects.model import ObjectModel
from mechsearch.sim.scene import Pusher, pusher_model
from mechsearch.types import Array, Floats

RATE = 240
ITERATIONS = 50
TABLE_FRICTION = 0.6
OBJECT_FRICTION = 0.5


class PeerWorld:
    """Objects on a table and the pusher, in PyBullet; closed by `with` or `close`."""

    def __init__(
        self,
        models: Sequence[ObjectModel],
        config: HeapEnvConfig | None = None,
        pusher: bool = True,
        rigid: bool = False,
        visual: bool = True,
    ) -> None:
        """Load the scene.

        Args:
            models: The objects, in the order of all poses.
            config: Of our environment, whose table, pusher and time of an action it takes.
            pusher: Whether there is one.
            rigid: Use Bullet's plain rigid bodies ("maximal coordinates", experimental in
                PyBullet) for the objects, and not the multi-bodies that it loads by default.
            visual: Whether it will be rendered.
        """
        self.config = config or HeapEnvConfig()
        self.client = pybullet.connect(pybullet.DIRECT)
        self._call("setGravity", 0, 0, -9.81)
        self._call(
            "setPhysicsEngineParameter", fixedTimeStep=1 / RATE, numSolverIterations=ITERATIONS
        )
        self._turns = [_principal_quaternion(model) for model in models]
        self.bodies = [self._add_object(model, rigid, visual) for model in models]
        self._add_table()
        self.pusher = self._add_pusher(self.config.pusher, visual) if pusher else None
        physics = self.config.physics
        self._travel = round(physics.action_steps * physics.time_step * RATE)
        seconds = (physics.action_steps + physics.rest_steps) * physics.time_step
        self._steps = round(seconds * RATE)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Forget the scene."""
        pybullet.disconnect(self.client)

    @property
    def poses(self) -> Floats:
        """Poses (N, 7) of all objects, as ours: centre of mass, quaternion (w, x, y, z)."""
        states = [self._call("getBasePositionAndOrientation", body) for body in self.bodies]
        positions = np.array([state[0] for state in states])
        turned = np.roll(np.array([state[1] for state in states]), 1, axis=1)
        inverse = np.array(self._turns) * [1.0, -1.0, -1.0, -1.0]
        return np.concatenate([positions, quaternion_product(turned, inverse)], axis=1)

    @property
    def speeds(self) -> Floats:
        """Linear and angular velocities (N, 6) of all objects [m/s, rad/s]."""
        pairs = [self._call("getBaseVelocity", body) for body in self.bodies]
        return np.array([[*linear, *angular] for linear, angular in pairs]).reshape(-1, 6)

    @property
    def pusher_position(self) -> Floats:
        """Position (3,) of the fingertip [m]."""
        return np.array([s[0] for s in self._call("getJointStates", self.pusher, (0, 1, 2))])

    def reset(self, poses: Array, pusher_position: Array | None = None) -> None:
        """Put all objects at rest at `poses` (N, 7), and the pusher where it is told."""
        for index, pose in enumerate(np.asarray(poses, np.float64)):
            self.place(index, pose)
        if pusher_position is not None:
            for axis in range(3):
                self._call("resetJointState", self.pusher, axis, float(pusher_position[axis]), 0.0)

    def place(self, index: int, pose: Array) -> None:
        """Put one object at rest at a pose (7,)."""
        w, x, y, z = quaternion_product(pose[3:], self._turns[index]).tolist()
        body, position = self.bodies[index], pose[:3].tolist()
        self._call("resetBasePositionAndOrientation", body, position, (x, y, z, w))
        self._call("resetBaseVelocity", body, (0, 0, 0), (0, 0, 0))

    def step(self, steps: int) -> None:
        """Advance by a number of time steps."""
        for _ in range(steps):
            pybullet.stepSimulation(self.client)

    def push(self, target: Array) -> None:
        """Move the fingertip towards `target` (3,) [m]: as many seconds as our action lasts."""
        start, goal = self.pusher_position, np.asarray(target, np.float64)
        velocity = ((goal - start) * (RATE / self._travel)).tolist()
        for row in start + np.linspace(0, 1, self._travel + 1)[1:, None] * (goal - start):
            self._servo(row.tolist(), velocity)
            pybullet.stepSimulation(self.client)
        self._servo(goal.tolist(), [0.0, 0.0, 0.0])
        self.step(self._steps - self._travel)

    def displace(self, offset: Array) -> None:
        """Push by a commanded displacement (3,) [m], inside the workspace."""
        self.push(self.config.workspace.clip(self.pusher_position + offset))

    def add_walls(self, x: float, y: float, radius: float, sides: int = 16) -> list[int]:
        """Add the confining wall of a drop; return the bodies to give to `remove`."""
        middle = radius + 0.01
        half_width = 1.1 * (middle + 0.01) * float(np.tan(np.pi / sides))
        shape = self._call(
            "createCollisionShape", pybullet.GEOM_BOX, halfExtents=[0.01, half_width, 0.5]
        )
        walls = []
        for angle in np.linspace(0, 2 * np.pi, sides, endpoint=False):
            place = [x + middle * float(np.cos(angle)), y + middle * float(np.sin(angle)), 0.5]
            turn = pybullet.getQuaternionFromEuler([0, 0, float(angle)])
            walls.append(self._call("createMultiBody", 0, shape, -1, place, turn))
            self._call("changeDynamics", walls[-1], -1, lateralFriction=0.05 / OBJECT_FRICTION**0.5)
        return walls

    def remove(self, bodies: Sequence[int]) -> None:
        """Remove bodies from the scene."""
        for body in bodies:
            self._call("removeBody", body)

    def _call(self, name: str, *values: Any, **options: Any) -> Any:
        return getattr(pybullet, name)(*values, **options, physicsClientId=self.client)

    def _servo(self, positions: list[float], velocities: list[float]) -> None:
        pybullet.setJointMotorControlArray(
            self.pusher, (0, 1, 2), pybullet.POSITION_CONTROL, positions, velocities,
            [self.config.pusher.force] * 3, physicsClientId=self.client,
        )  # fmt: skip

    def _add_object(self, model: ObjectModel, rigid: bool, visual: bool) -> int:
        turn = rotation_from_quaternion(_principal_quaternion(model))
        shape = self._call(
            "createCollisionShape", pybullet.GEOM_MESH, fileName=str(_hull_file(model))
        )
        seen = self.add_visual(model) if visual else -1
        body: int = self._call(
            "createMultiBody", model.mass, shape, seen, useMaximalCoordinates=int(rigid)
        )
        self._call(
            "changeDynamics", body, -1, mass=model.mass, lateralFriction=model.friction**0.5,
            restitution=0.0, linearDamping=0.0, angularDamping=0.0,
            localInertiaDiagonal=np.diag(turn.T @ model.inertia @ turn).tolist(),
        )  # fmt: skip
        return body

    def add_visual(self, model: ObjectModel) -> int:
        """Return the shape of a model's visual mesh, in its principal axes."""
        vertices = model.vertices @ rotation_from_quaternion(_principal_quaternion(model))
        shape: int = self._call(
            "createVisualShape", pybullet.GEOM_MESH, vertices=vertices.tolist(),
            indices=model.faces.ravel().tolist(), normals=_normals(vertices).tolist(),
        )  # fmt: skip
        return shape

    def _add_table(self) -> None:
        half = self.config.workspace.table_half
        extents = [half, half, 0.1]
        shape = self._call("createCollisionShape", pybullet.GEOM_BOX, halfExtents=extents)
        table: int = self._call("createMultiBody", 0, shape, -1, [0, 0, -0.1])
        floor = self._call("createCollisionShape", pybullet.GEOM_PLANE)
        ground = self._call("createMultiBody", 0, floor, -1, [0, 0, self.config.workspace.floor])
        for body in (table, ground):
            # Bodies without a visual shape show their collision shape, unless it is transparent.
            self._call("changeVisualShape", body, -1, rgbaColor=[1, 1, 1, 0])
        friction = TABLE_FRICTION / OBJECT_FRICTION**0.5
        self._call("changeDynamics", table, -1, lateralFriction=friction, restitution=0.0)

    def _add_pusher(self, pusher: Pusher, visual: bool) -> int:
        """Add a capsule on three sliding joints; the last link carries it, origin at the tip."""
        capsule = self._call(
            "createCollisionShape", pybullet.GEOM_CAPSULE, radius=pusher.radius,
            height=pusher.length - 2 * pusher.radius,
            collisionFramePosition=[0, 0, pusher.length / 2],
        )  # fmt: skip
        seen = self.add_visual(pusher_model(pusher)) if visual else -1
        slide, still, turn = pybullet.JOINT_PRISMATIC, [[0, 0, 0]] * 3, [[0, 0, 0, 1]] * 3
        body: int = self._call(
            "createMultiBody", 0, -1, -1, [0, 0, 0],
            linkMasses=[1e-3, 1e-3, pusher.mass], linkCollisionShapeIndices=[-1, -1, capsule],
            linkVisualShapeIndices=[-1, -1, seen], linkPositions=still, linkOrientations=turn,
            linkInertialFramePositions=still, linkInertialFrameOrientations=turn,
            linkParentIndices=[0, 1, 2], linkJointTypes=[slide] * 3,
            linkJointAxis=np.eye(3).tolist(),
        )  # fmt: skip
        self._call("changeDynamics", body, 2, lateralFriction=pusher.friction**0.5)
        return body


@cache
def _principal_quaternion(model: ObjectModel) -> Floats:
    """Return the rotation (4,) from principal axes to the object frame; Bullet knows no other."""
    _, axes = np.linalg.eigh(model.inertia)
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    turn: Floats = Rotation.from_matrix(axes).as_quat(scalar_first=True)
    return turn


def _normals(vertices: Floats) -> Floats:
    """Return any normals (V, 3): TinyRenderer wants them for colours alone."""
    lengths = np.linalg.norm(vertices, axis=1, keepdims=True)
    normals: Floats = vertices / np.maximum(lengths, 1e-9)
    return normals


@cache
def _hull_folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="benchmark-hulls-")


@cache
def _hull_file(model: ObjectModel) -> Path:
    """Write the convex parts (in principal axes) as one OBJ: Bullet makes each group a hull."""
    turn = rotation_from_quaternion(_principal_quaternion(model))
    lines, first = [], 1
    for number, part in enumerate(model.parts):
        hull = ConvexHull(part @ turn)
        place = {vertex: first + i for i, vertex in enumerate(hull.vertices)}
        lines.append(f"o part{number}")
        lines += ["v {:.9f} {:.9f} {:.9f}".format(*hull.points[v]) for v in hull.vertices]
        lines += ["f " + " ".join(str(place[v]) for v in face) for face in hull.simplices]
        first += len(hull.vertices)
    path = Path(_hull_folder().name) / f"{len(list(Path(_hull_folder().name).iterdir()))}.obj"
    path.write_text("\n".join(lines) + "\n")
    return path
