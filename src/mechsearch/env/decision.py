"""What a robot may decide in retrieval: a push, a grasp of the target, or an object's removal."""

from dataclasses import dataclass
from typing import Any, Self

import gymnasium
import numpy as np
from numpy.typing import NDArray

from mechsearch.geometry import rotation_from_quaternion, yaw_quaternion
from mechsearch.sim import Workspace
from mechsearch.types import (
    DECISION_NAMES,
    DECISION_SIZE,
    GRASP,
    PUSH,
    REMOVE,
    Array,
    Floats,
    MechSearchError,
    finite_numbers,
    real_array,
    shown,
)

STEEPEST = float(np.cos(np.deg2rad(60.0)))
"""Least upward part of a grasp's z axis: grippers come from above, tilted by at most 60 degrees."""

_VECTOR = (
    f"a decision is ({DECISION_SIZE},) finite numbers: its kind, the gripper's number, and a "
    "displacement (3,) or a pose (7,)"
)

_BELOW = 0.01
"""How far below the table a grasp's centre may be [m]: the gripper stops at the table."""


def reachable(poses: Array, workspace: Workspace | None = None) -> NDArray[np.bool_]:
    """Return which poses (..., 7) of a gripper's frame are in reach (...,).

    Args:
        poses: Of a gripper's frame.
        workspace: Of the robot; None takes the usual one.
    """
    workspace = workspace or Workspace()
    above = np.abs(poses[..., :2]).max(axis=-1) <= workspace.table_half
    high = (poses[..., 2] >= -_BELOW) & (poses[..., 2] <= workspace.high)
    upright = rotation_from_quaternion(poses[..., 3:])[..., 2, 2] >= STEEPEST
    return np.asarray(above & high & upright)


@dataclass(frozen=True)
class Decision:
    """One decision.

    Attributes:
        kind: `PUSH`, `GRASP` (of the target) or `REMOVE` (of another object, into the tray).
        numbers: Of a push the displacement (3,) of the tip in [-1, 1], in units of 5 cm; else the
            pose (7,) of the gripper's frame in the world.
        gripper: Number of the gripper that grasps; the first one pushes.
    """

    kind: int
    numbers: tuple[float, ...]
    gripper: int = 0

    def __post_init__(self) -> None:
        if self.kind not in (PUSH, GRASP, REMOVE):
            raise MechSearchError(
                f"a decision of kind {shown(self.kind)}; expected {PUSH} (push), {GRASP} (grasp of "
                f"the target) or {REMOVE} (removal of another object)"
            )
        name, expected = DECISION_NAMES[self.kind], 3 if self.kind == PUSH else 7
        finite_numbers(self.numbers, (expected,), f"a {name} is {expected} finite numbers")
        if self.kind != PUSH and abs(float(np.linalg.norm(self.numbers[3:])) - 1.0) > 1e-4:
            raise MechSearchError(
                f"a {name} with the quaternion {self.numbers[3:]}; expected length 1"
            )

    @classmethod
    def push(cls, displacement: Array) -> Self:
        """Return the push by a displacement (3,) in [-1, 1], in units of 5 cm."""
        return cls(PUSH, _plain(displacement))

    @classmethod
    def grasp(cls, pose: Array, gripper: int = 0) -> Self:
        """Return the grasp of the target at a pose (7,) of the gripper's frame."""
        return cls(GRASP, _plain(pose), gripper)

    @classmethod
    def remove(cls, pose: Array, gripper: int = 0) -> Self:
        """Return the removal of what is grasped at a pose (7,) of the gripper's frame."""
        return cls(REMOVE, _plain(pose), gripper)

    @classmethod
    def of(cls, vector: Array) -> Self:
        """Return the decision that a vector (9,) stands for.

        Raises:
            MechSearchError: If it stands for none.
        """
        kind, gripper, *numbers = finite_numbers(vector, (DECISION_SIZE,), _VECTOR).tolist()
        if kind % 1 or gripper % 1:
            raise MechSearchError(
                f"a decision of kind {kind} by gripper {gripper}; expected whole numbers"
            )
        return cls(int(kind), tuple(numbers[:3] if kind == PUSH else numbers), int(gripper))

    def vector(self) -> Floats:
        """Return the decision as a vector (9,): its kind, the gripper's number, and the others."""
        vector = np.zeros(DECISION_SIZE)
        vector[:2] = self.kind, self.gripper
        vector[2 : 2 + len(self.numbers)] = self.numbers
        return vector


def _plain(numbers: Array) -> tuple[float, ...]:
    values = real_array(numbers, "a decision is of numbers")
    return tuple(np.asarray(values, np.float64).ravel().tolist())


class DecisionSpace(gymnasium.spaces.Box):
    """The vectors of all decisions; samples are pushes, and grasps from straight above."""

    def __init__(self, grippers: int, workspace: Workspace) -> None:
        """Take the number of grippers, and the table that they reach."""
        reach = workspace.table_half
        low = [PUSH, 0, -1, -1, -1, -1, -1, -1, -1]
        high = [REMOVE, grippers - 1, 1, 1, 1, 1, 1, 1, 1]
        self._low, self._high = (-reach, -reach, 0.0), (reach, reach, workspace.high)
        super().__init__(np.array(low, np.float64), np.array(high, np.float64), dtype=np.float64)

    def sample(self, mask: None = None, probability: None = None) -> NDArray[Any]:
        """Return a vector (9,) of a decision of any kind."""
        rng = self.np_random
        kind, gripper = int(rng.integers(3)), int(rng.integers(self.high[1] + 1))
        if kind == PUSH:
            return Decision.push(rng.uniform(-1, 1, 3)).vector()
        turn = yaw_quaternion(rng.uniform(-np.pi, np.pi))
        pose = (*rng.uniform(self._low, self._high).tolist(), *turn.tolist())
        return Decision(kind, pose, gripper).vector()

    def contains(self, x: Any) -> bool:
        """Return whether a vector (9,) stands for a decision within these bounds."""
        try:
            Decision.of(x)
        except MechSearchError:
            return False
        return bool(super().contains(x))
