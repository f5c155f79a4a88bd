"""The same scene in PyBullet, the paper's engine: 240 Hz and 50 solver iterations.

Bullet multiplies the friction of two bodies where MuJoCo takes the larger: the coefficients here
give the same sliding, spinning and rolling friction in every contact of objects, table and pusher,
as long as the objects' own are the usual ones.
"""

import tempfile
import weakref
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pybullet
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from mechsearch.geometry import quaternion_product, rotation_from_quaternion
from mechsearch.objects.model import FRICTION, ObjectModel
from mechsearch.sim.scene import PhysicsConfig, Pusher, Workspace, pusher_model
from mechsearch.sim.world import HeapWorld, runaway, settle
from mechsearch.types import Array, Floats, MechSearchError

RATE = 240
"""Steps a second."""

_ITERATIONS = 50

_AWAY = np.array([0.0, 0.0, 5.0])
_TABLE_FRICTION = 0.6
_SPINNING = 0.005
"""Torque against spinning, of each contact, for each newton of its force [m]."""

_ROLLING = 0.001
"""Likewise against rolling, on the table alone [m]."""


class BulletWorld(HeapWorld):
    """Objects on a table and the pusher; see `sim.world.HeapWorld`.

    Every step is simulated: nothing sleeps, and the pusher's free travel is not skipped. The pusher
    is as strong as MuJoCo's, but Bullet's motor holds it to its path within that force, without
    the give of `Pusher.stiffness`.

    Attributes:
        config: Of which steps are Bullet's.
        workspace: Table and bounds.
        client: Of PyBullet.
        bodies: Of the objects, in their order.
        effector: Body of the pusher; -1 without one.
        motion: None: no arm pushes.
        close: Forgets the scene, as happens when the world is forgotten.
    """

    motion = None

    def __init__(
        self,
        models: Sequence[ObjectModel],
        workspace: Workspace | None = None,
        pusher: Pusher | None = None,
        config: PhysicsConfig | None = None,
        rolling: bool = True,
        rigid: bool = False,
    ) -> None:
        """Load the scene.

        Args:
            models: The objects, in the order of all poses.
            workspace: Table and bounds.
            pusher: The end effector, or None for a world without one.
            config: Of which the times of an action and what counts as a failure are taken; step and
                solver are Bullet's own.
            rolling: Whether contacts resist spinning and rolling.
            rigid: Use Bullet's plain rigid bodies ("maximal coordinates", experimental in PyBullet)
                for the objects, and not the multi-bodies that it loads by default.
        """
        given = config or PhysicsConfig()
        travel = max(1, round(given.action_steps * given.time_step * RATE))
        self.config = replace(
            given,
            time_step=1 / RATE,
            action_steps=travel,
            rest_steps=max(0, round(given.steps * given.time_step * RATE) - travel),
        )
        self.workspace = workspace or Workspace()
        self.client = pybullet.connect(pybullet.DIRECT)
        self.close = weakref.finalize(self, pybullet.disconnect, self.client)
        self._models, self._pusher = models, pusher
        self._rolling, self._rigid = rolling, rigid
        self._turns = [principal_quaternion(model) for model in models]
        self._load()

    def _renew(self) -> None:
        """Load the scene anew, so that what follows depends on the poses alone.

        Bullet keeps something of what was before, even over `restoreState`.
        """
        if not self._fresh:
            self._call("resetSimulation")
            self._load()

    def _load(self) -> None:
        self._call("setGravity", 0, 0, -9.81)
        self._call(
            "setPhysicsEngineParameter", fixedTimeStep=1 / RATE, numSolverIterations=_ITERATIONS
        )
        self.bodies = [self._add_object(i, model) for i, model in enumerate(self._models)]
        self._add_table()
        self.effector = -1 if self._pusher is None else self._add_pusher(self._pusher)
        self._fresh = True

    @property
    def poses(self) -> Floats:
        """Poses (N, 7) of all objects."""
        states = [self._call("getBasePositionAndOrientation", body) for body in self.bodies]
        positions = np.array([state[0] for state in states])
        turned = np.roll(np.array([state[1] for state in states]), 1, axis=1)
        inverse = np.array(self._turns) * [1.0, -1.0, -1.0, -1.0]
        return np.concatenate([positions, quaternion_product(turned, inverse)], axis=1)

    @property
    def velocities(self) -> Floats:
        """Linear and angular velocities (N, 6) of all objects, in world axes [m/s, rad/s]."""
        pairs = [self._call("getBaseVelocity", body) for body in self.bodies]
        return np.array([[*linear, *angular] for linear, angular in pairs]).reshape(-1, 6)

    @property
    def pusher_position(self) -> Floats:
        """Position (3,) of the fingertip [m]."""
        states = self._call("getJointStates", self.effector, (0, 1, 2))
        return np.array([state[0] for state in states])

    def reset(self, poses: Array, pusher_position: Array | None = None) -> None:
        """Put all objects at rest at `poses` (N, 7), and the pusher where it is told."""
        self._renew()
        for index, pose in enumerate(np.asarray(poses, np.float64)):
            self.place(index, pose)
        if self._pusher is not None:
            tip = (_AWAY if pusher_position is None else np.asarray(pusher_position)).tolist()
            for axis in range(3):
                self._call("resetJointState", self.effector, axis, tip[axis], 0.0)
            self._servo(tip, [0.0, 0.0, 0.0])

    def place(self, index: int, pose: Array) -> None:
        """Put one object at rest at a pose (7,)."""
        w, x, y, z = quaternion_product(pose[3:], self._turns[index]).tolist()
        body, position = self.bodies[index], pose[:3].tolist()
        self._call("resetBasePositionAndOrientation", body, position, (x, y, z, w))
        self._call("resetBaseVelocity", body, (0, 0, 0), (0, 0, 0))

    def remove(self, index: int) -> None:
        """Take one object out of everything's way, as it is."""
        pose = self.poses[index]
        self.place(index, np.array([pose[0] + 10.0 * (index + 1), *pose[1:]]))

    def pusher_is_free(self) -> bool:
        """Return whether nothing touches the pusher where it stands."""
        self._fresh = False
        self._call("performCollisionDetection")
        return all(overlap <= 0 for overlap in self._overlaps(bodyA=self.effector))

    def settled(self, poses: Array) -> Floats:
        """Return where objects come to rest that MuJoCo has put to rest at `poses` (N, 7).

        Raises:
            RuntimeError: If they do not, or one leaves the table.
        """
        self.reset(poses)
        if settle(self):
            return self.poses
        gone = self.workspace.off_table(self.poses)
        left = ", ".join(self._models[i].name for i in np.flatnonzero(gone).tolist())
        why = f"{left} left the table" if left else "it keeps moving"
        raise RuntimeError(f"the heap does not come to rest in Bullet: {why}")

    def step(self, steps: int) -> None:
        """Advance by a number of time steps."""
        self._fresh = False
        for _ in range(steps):
            pybullet.stepSimulation(self.client)

    def push(self, target: Array) -> bool:
        """Move the fingertip towards `target` (3,) [m]: one action's worth of simulated time.

        Returns:
            True: all of it was simulated.
        """
        travel = self.config.action_steps
        start, goal = self.pusher_position, np.asarray(target, np.float64)
        velocity = ((goal - start) * (RATE / travel)).tolist()
        for row in start + np.linspace(0, 1, travel + 1)[1:, None] * (goal - start):
            self._servo(row.tolist(), velocity)
            pybullet.stepSimulation(self.client)
        self._servo(goal.tolist(), [0.0, 0.0, 0.0])
        self.step(self.config.rest_steps)
        return True

    def failure(self) -> str | None:
        """Return the name of a simulator failure, or None while physics can be trusted."""
        poses, velocities = self.poses, self.velocities
        if not (np.isfinite(poses).all() and np.isfinite(velocities).all()):
            return "not a number"
        if found := runaway(poses, velocities, self.workspace, self.config):
            return found
        deep = max(self._overlaps(), default=0.0) > self.config.deep_penetration
        return "deep penetration" if deep else None

    def snapshot(self) -> Floats:
        """Refuse: what Bullet keeps of contacts cannot be taken out of it.

        Raises:
            MechSearchError: Always.
        """
        raise MechSearchError(
            "the engine bullet has no snapshots, which look-ahead and learning need; expected the "
            "engine mujoco"
        )

    def restore(self, state: Array) -> None:
        """Refuse, as `snapshot`.

        Raises:
            MechSearchError: Always.
        """
        self.snapshot()

    def _overlaps(self, **of: int) -> list[float]:
        """Return the overlap of every contact [m], in the last computed step."""
        return [-contact[8] for contact in self._call("getContactPoints", **of)]

    def _call(self, name: str, *values: Any, **options: Any) -> Any:
        return getattr(pybullet, name)(*values, **options, physicsClientId=self.client)

    def _servo(self, positions: list[float], velocities: list[float]) -> None:
        assert self._pusher is not None
        pybullet.setJointMotorControlArray(
            self.effector, (0, 1, 2), pybullet.POSITION_CONTROL, positions, velocities,
            [self._pusher.force] * 3, physicsClientId=self.client,
        )  # fmt: skip

    def _add_object(self, index: int, model: ObjectModel) -> int:
        turn = rotation_from_quaternion(principal_quaternion(model))
        shape = self._call(
            "createCollisionShape", pybullet.GEOM_MESH, fileName=str(_hull_file(model))
        )
        body: int = self._call(
            "createMultiBody", model.mass, shape, self._visual(model), [3.0 * index, 0.0, 100.0],
            useMaximalCoordinates=int(self._rigid),
        )  # fmt: skip
        self._call(
            "changeDynamics", body, -1, mass=model.mass, linearDamping=0.0, angularDamping=0.0,
            localInertiaDiagonal=np.diag(turn.T @ model.inertia @ turn).tolist(),
        )  # fmt: skip
        self._rub(body, -1, model.friction**0.5, _SPINNING / (2 * FRICTION**0.5))
        return body

    def _visual(self, model: ObjectModel) -> int:
        """Return what is seen of a model, in its principal axes: nothing, images are ours."""
        return -1

    def _add_table(self) -> None:
        """Add the table's top, without an edge: what crosses the edge has left the scene."""
        shape = self._call("createCollisionShape", pybullet.GEOM_PLANE)
        table: int = self._call("createMultiBody", 0, shape)
        # Bodies without a visual shape show their collision shape, unless it is transparent.
        self._call("changeVisualShape", table, -1, rgbaColor=[1, 1, 1, 0])
        own, other = _TABLE_FRICTION / FRICTION**0.5, FRICTION**0.5
        spinning = _SPINNING * (1 - own / (2 * other)) / other
        self._rub(table, -1, own, spinning, _ROLLING / other)

    def _add_pusher(self, pusher: Pusher) -> int:
        """Add a capsule on three sliding joints; the last link carries it, origin at the tip."""
        capsule = self._call(
            "createCollisionShape", pybullet.GEOM_CAPSULE, radius=pusher.radius,
            height=pusher.length - 2 * pusher.radius,
            collisionFramePosition=[0, 0, pusher.length / 2],
        )  # fmt: skip
        slide, still, turn = pybullet.JOINT_PRISMATIC, [[0, 0, 0]] * 3, [[0, 0, 0, 1]] * 3
        body: int = self._call(
            "createMultiBody", 0, -1, -1, [0, 0, 0],
            linkMasses=[1e-3, 1e-3, pusher.mass], linkCollisionShapeIndices=[-1, -1, capsule],
            linkVisualShapeIndices=[-1, -1, self._visual(pusher_model(pusher))],
            linkPositions=still, linkOrientations=turn,
            linkInertialFramePositions=still, linkInertialFrameOrientations=turn,
            linkParentIndices=[0, 1, 2], linkJointTypes=[slide] * 3,
            linkJointAxis=np.eye(3).tolist(),
        )  # fmt: skip
        self._rub(body, 2, pusher.friction**0.5, _SPINNING / (2 * FRICTION**0.5))
        return body

    def _rub(
        self, body: int, link: int, sliding: float, spinning: float, rolling: float = 0.0
    ) -> None:
        """Set the friction of a body's link; of two bodies Bullet adds a b' + a' b, sliding b."""
        more = {"spinningFriction": spinning, "rollingFriction": rolling} if self._rolling else {}
        self._call("changeDynamics", body, link, lateralFriction=sliding, restitution=0.0, **more)


@cache
def principal_quaternion(model: ObjectModel) -> Floats:
    """Return the rotation (4,) from principal axes to the object frame; Bullet knows no other."""
    _, axes = np.linalg.eigh(model.inertia)
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    turn: Floats = Rotation.from_matrix(axes).as_quat(scalar_first=True)
    return turn


@cache
def _hull_folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="mechsearch-hulls-")


@cache
def _hull_file(model: ObjectModel) -> Path:
    """Write the convex parts (in principal axes) as one OBJ: Bullet makes each group a hull."""
    turn = rotation_from_quaternion(principal_quaternion(model))
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
