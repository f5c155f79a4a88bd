"""The peer's images: TinyRenderer depth and ids, and the target alone for its whole projection."""

from collections.abc import Sequence

import numpy as np
import pybullet
from numpy.typing import NDArray

from benchmarks.peer import PeerWorld
from mechsearch.camera import Camera
from mechsearch.geometry import invert
from mechsearch.objects.model import ObjectModel

_NEAR, _FAR = 0.3, 1.5


class PeerCamera:
    """Renders a peer's world, and its target in a scene of its own, where nothing hides it.

    Shadows are off, and the table's depth is filled in where nothing else is seen: TinyRenderer
    takes longer for its two large triangles. The scene of the target spares the peer moving 14
    objects away and back.
    """

    def __init__(
        self, world: PeerWorld, models: Sequence[ObjectModel], target: int, camera: Camera
    ) -> None:
        """Set up the view of one heap."""
        self._world, self._target, self._camera = world, target, camera
        self._alone = PeerWorld([models[target]], world.task, pusher=False)
        self._view, self._projection = _matrices(camera)
        slopes = camera.directions() @ camera.pose[:3, :3].T
        self._table = (-camera.pose[2, 3] / slopes[..., 2]).astype(np.float32)

    def close(self) -> None:
        """Forget the target's own scene."""
        self._alone.close()

    def images(self) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        """Return depth (H, W) [m] and body ids (H, W)."""
        buffer, ids = self._render(self._world.client)
        depth = np.float32(_FAR * _NEAR) / (np.float32(_FAR) - np.float32(_FAR - _NEAR) * buffer)
        return np.where(ids < 0, self._table, depth), ids

    def amodal(self) -> NDArray[np.bool_]:
        """Return the target's whole projection (H, W)."""
        position, turn = pybullet.getBasePositionAndOrientation(
            self._world.bodies[self._target], physicsClientId=self._world.client
        )
        pybullet.resetBasePositionAndOrientation(
            self._alone.bodies[0], position, turn, physicsClientId=self._alone.client
        )
        return np.asarray(self._render(self._alone.client)[1] >= 0, np.bool_)

    def occlusion(self, ids: NDArray[np.int32], amodal: NDArray[np.bool_]) -> float:
        """Return the share of the target that others hide; the pusher's pixels do not count."""
        if self._world.effector >= 0:
            amodal = amodal & (ids != self._world.effector)
        whole = int(amodal.sum())
        seen = int((amodal & (ids == self._world.bodies[self._target])).sum())
        return 1.0 - seen / whole if whole else 1.0

    def _render(self, client: int) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        _, _, _, depth, ids = pybullet.getCameraImage(
            self._camera.width, self._camera.height, self._view, self._projection, shadow=0,
            renderer=pybullet.ER_TINY_RENDERER, physicsClientId=client,
        )  # fmt: skip
        shape = self._camera.height, self._camera.width
        return np.reshape(depth, shape), np.reshape(ids, shape)


def _matrices(camera: Camera) -> tuple[list[float], list[float]]:
    """Return OpenGL view and projection matrices, column by column.

    TinyRenderer's pixel (0, 0) has its centre half a pixel beside OpenGL's.
    """
    width, height = camera.width, camera.height
    view = np.diag([1.0, -1.0, -1.0, 1.0]) @ invert(camera.pose)
    projection = np.zeros((4, 4))
    projection[0, 0] = 2 * camera.fx / width
    projection[0, 2] = 1 - 2 * camera.cx / width
    projection[1, 1] = 2 * camera.fy / height
    projection[1, 2] = 2 * (camera.cy + 1) / height - 1
    projection[2, 2] = -(_FAR + _NEAR) / (_FAR - _NEAR)
    projection[2, 3] = -2 * _FAR * _NEAR / (_FAR - _NEAR)
    projection[3, 2] = -1
    return view.T.ravel().tolist(), projection.T.ravel().tolist()
