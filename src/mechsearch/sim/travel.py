"""How far the pusher travels before it can touch anything."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import mujoco
import numpy as np

from mechsearch.geometry import rotation_from_quaternion
from mechsearch.grippers import AnyGripper, Cylinder, Gripper
from mechsearch.sim.gripper import close_jaws
from mechsearch.sim.scene import PhysicsConfig, Pusher, Workspace, compile_scene
from mechsearch.types import Array, Floats


@dataclass(frozen=True)
class FreeTravel:
    """The pusher's answer to one command where nothing touches it, as shares of the command.

    The servo is linear and alike along all axes, so one answer serves every command.

    Attributes:
        position: After each of S steps, from 0 (S + 1,).
        velocity: Likewise (S + 1,) [1/s].
        set_point: Of the servo, likewise (S + 1,).
    """

    position: Floats
    velocity: Floats
    set_point: Floats


@cache
def free_travel(pusher: Pusher | AnyGripper, config: PhysicsConfig) -> FreeTravel:
    """Return the answer of a pusher that starts at rest, as the engine itself computes it.

    A gripper pushes with closed jaws.
    """
    if isinstance(pusher, Pusher):
        model = compile_scene((), Workspace(), pusher, (), config)
        data = mujoco.MjData(model)
    else:
        model = compile_scene((), Workspace(), None, (), config, travelling=(pusher,))
        data = mujoco.MjData(model)
        if isinstance(pusher, Gripper):
            close_jaws(model, data, 0, pusher)
    length = 0.05
    rows = [(0.0, 0.0, 0.0)]
    for step in range(config.steps):
        moving = step < config.action_steps
        data.ctrl[0] = length / (config.action_steps * config.time_step) if moving else 0.0
        mujoco.mj_step(model, data)
        rows.append((data.qpos[0], data.qvel[0], data.act[0]))
    return FreeTravel(*(np.array(rows).T / length))


class Outlines:
    """Bounding boxes of all convex parts of some objects, wherever they lie."""

    def __init__(self, parts: Sequence[Sequence[Floats]]) -> None:
        """Take the convex parts, vertices (P, 3) [m], of every object."""
        self._points = [np.concatenate(own) for own in parts]
        self._starts = [np.cumsum([0, *(len(part) for part in own[:-1])]) for own in parts]
        ends = np.cumsum([0, *(len(own) for own in parts)])
        self._rows = [slice(start, end) for start, end in pairwise(ends.tolist())]
        # Axis by axis in memory: many boxes are compared with one at once.
        self._low, self._high = np.zeros((2, 3, ends[-1])).swapaxes(1, 2)
        self._poses = np.full((len(parts), 7), np.nan)

    def boxes(self, poses: Floats) -> tuple[Floats, Floats]:
        """Return the lowest and highest corners (B, 3) [m] of all parts, objects at (N, 7)."""
        changed = poses != self._poses
        if not changed.any():
            return self._low, self._high
        moved = changed.any(axis=1)
        rotations = rotation_from_quaternion(poses[moved, 3:])
        for i, rotation in zip(np.flatnonzero(moved).tolist(), rotations, strict=True):
            points, rows = self._points[i] @ rotation.T + poses[i, :3], self._rows[i]
            np.minimum.reduceat(points, self._starts[i], axis=0, out=self._low[rows])
            np.maximum.reduceat(points, self._starts[i], axis=0, out=self._high[rows])
        self._poses = poses.copy()
        return self._low, self._high


def clear_steps(
    path: Floats, boxes: tuple[Floats, Floats], part: Cylinder, clearance: float
) -> int:
    """Return after how many steps the pusher is still farther than `clearance` from all boxes.

    Args:
        path: Tip of the pusher after each step (S + 1, 3) [m].
        boxes: Lowest and highest corners (B, 3) [m].
        part: Of the pusher.
        clearance: [m].

    Returns:
        The last such step, S if all are; 0 too if even the start is not.
    """
    low, high = boxes
    reach = part.radius + clearance
    wide = np.array([reach, reach, clearance])
    bottom, top = np.array([0.0, 0.0, part.low]), np.array([0.0, 0.0, part.high])
    near = (low < path.max(axis=0) + top + wide) & (high > path.min(axis=0) + bottom - wide)
    close = near.all(axis=1).nonzero()[0]
    if not len(close):
        return len(path) - 1
    low, high = low[close], high[close]
    flat = path[:, None, :2]
    beside = np.maximum(np.maximum(low[:, :2] - flat, flat - high[:, :2]), 0.0)
    height = path[:, 2, None]
    meets: Array = (
        ((beside * beside).sum(axis=2) < reach**2)
        & (height + part.low < high[:, 2] + clearance)
        & (height + part.high > low[:, 2] - clearance)
    ).any(axis=1)
    return max(int(np.argmax(meets)) - 1, 0) if meets.any() else len(path) - 1
