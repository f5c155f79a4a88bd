"""The paper's stack as a peer: our world in PyBullet, seen by TinyRenderer.

Rolling and spinning friction are left out: they would cost Bullet another 40 %.
"""

from collections.abc import Sequence
from types import TracebackType
from typing import Self

import numpy as np
import pybullet

from mechsearch.env.heap_env import HeapEnvConfig
from mechsearch.geometry import rotation_from_quaternion
from mechsearch.objects.model import FRICTION, ObjectModel
from mechsearch.sim.bullet import BulletWorld, principal_quaternion
from mechsearch.types import Array, Floats


class PeerWorld(BulletWorld):
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
            rigid: As in `BulletWorld`.
            visual: Whether it will be rendered.
        """
        self.task, self._visible = config or HeapEnvConfig(), visual
        effector = self.task.pusher if pusher else None
        super().__init__(models, self.task.workspace, effector, self.task.physics, False, rigid)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.close()

    def displace(self, offset: Array) -> None:
        """Push by a commanded displacement (3,) [m], inside the workspace."""
        self.push(self.workspace.clip(self.pusher_position + offset))

    def add_walls(self, x: float, y: float, radius: float, sides: int = 16) -> list[int]:
        """Add the confining wall of a drop; return the bodies to give to `remove_walls`."""
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
            self._rub(walls[-1], -1, 0.05 / FRICTION**0.5, 0.0)
        return walls

    def remove_walls(self, walls: Sequence[int]) -> None:
        """Take the confining wall away."""
        for body in walls:
            self._call("removeBody", body)

    def _renew(self) -> None:
        """Go on in the same scene: its time is measured, and nothing need repeat bit by bit."""

    def _visual(self, model: ObjectModel) -> int:
        if not self._visible:
            return -1
        vertices = model.vertices @ rotation_from_quaternion(principal_quaternion(model))
        shape: int = self._call(
            "createVisualShape", pybullet.GEOM_MESH, vertices=vertices.tolist(),
            indices=model.faces.ravel().tolist(), normals=_normals(vertices).tolist(),
        )  # fmt: skip
        return shape


def _normals(vertices: Floats) -> Floats:
    """Return any normals (V, 3): TinyRenderer wants them for colours alone."""
    lengths = np.linalg.norm(vertices, axis=1, keepdims=True)
    normals: Floats = vertices / np.maximum(lengths, 1e-9)
    return normals
