"""Records, names and protocols that cross the borders between packages."""

import importlib.util
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from math import isfinite
from reprlib import Repr
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Floats = NDArray[np.float64]
Observation = Mapping[str, Array]

ACTOR_KEYS = ("depth", "position_image", "ee_position")
"""What the actor sees (paper, section III-B): images and the end effector's own position."""

RGB_ACTOR_KEYS = ("depth", "rgb", "target_label", "ee_position")
"""The paper's "No Pose Input" ablation: colour and a one-hot target label instead of positions."""

PRIVILEGED_KEYS = ("target_offset", "clutter_offsets", "clutter_mask")
"""What only a simulator knows (paper, section III-C): object positions relative to the effector."""

IMAGE_KEYS = frozenset({"depth", "position_image", "rgb"})
TEACHER_KEYS = ("ee_position", *PRIVILEGED_KEYS)

GRASP_KEYS = ("grasp_depth", "segments")
"""What grasps are planned on: the fixed camera's depth, and which object each pixel shows."""

BUDGET_KEYS = ("pushes_left", "grasps_left", "removals_left")
"""How many decisions of each kind a robot has left."""

OCCLUSION_KEY = "occlusion"
"""How much of the target is hidden, in [0, 1], which only a simulator knows."""

RETRIEVAL_KEYS = (*ACTOR_KEYS, *GRASP_KEYS, *BUDGET_KEYS)
"""What is seen in retrieval."""

CALLED_UNCOVERED = 0.05
"""Occlusion up to which a policy is right that calls its target uncovered."""

ACTION_LENGTH = 0.05
"""Longest displacement of the end effector in one action [m] (paper, section IV-A)."""


PUSH, GRASP, REMOVE = 0, 1, 2
"""Kinds of decisions in retrieval: a push, a grasp of the target, the removal of another object."""

DECISION_NAMES = ("push", "grasp", "removal")
"""Names of the kinds, by number."""

DECISION_SIZE = 9
"""Numbers of a decision as a vector: its kind, the gripper's number, and seven more."""

USED_UP = "used up"
"""Outcome of a decision of a kind of which none was left: it was not carried out."""


class Outcome(StrEnum):
    """What became of one grasp."""

    SUCCESS = "success"
    BLOCKED = "blocked"
    MISSED = "missed"
    SLIPPED = "slipped"
    DROPPED = "dropped"
    WRONG_OBJECT = "wrong object"
    TWO_OBJECTS = "two objects"
    FAILURE = "failure"
    NO_SEAL = "no seal"


@dataclass(frozen=True, eq=False)
class Weighed:
    """What a policy weighed before it decided: for people to see, nothing depends on it.

    A policy that has it offers the last as its attribute `weighed`, None where it went on with what
    it had decided before.

    Attributes:
        kinds: Of each candidate (n,): `PUSH`, `GRASP` or `REMOVE`.
        ways: Of each (n,): the waypoints (K, 3) [m] of a push, or a grasp's pose (7,).
        values: What each promises (n,), the more the better.
        chosen: Index of what was decided.
        measure: What the values are, in words.
    """

    kinds: tuple[int, ...]
    ways: tuple[Floats, ...]
    values: Floats
    chosen: int
    measure: str


class MechSearchError(Exception):
    """Bad input: the message names the value, what was expected and the valid choices."""


EXTRAS = {
    "learn": ("PyTorch", "torch"),
    "report": ("Matplotlib", "matplotlib"), "meshes": ("CoACD", "coacd"),
    "ray": ("Ray", "ray"), "video": ("FFmpeg", "imageio_ffmpeg"),
    "export": ("ONNX", "onnxscript"), "robot": ("ONNX-Runtime", "onnxruntime"),
    "dds": ("CycloneDDS", "cyclonedds"),
    "calibration": ("OpenCV", "cv2"), "bullet": ("PyBullet", "pybullet"),
    "arms": ("mink", "mink"),
}  # fmt: skip
"""What each optional part of an installation brings: its name, and a module of it."""

_ALONE = {"arms": "pip install --no-deps mink qpsolvers daqp"}
"""How parts are installed that ask for another build of the physics engine, which would overwrite
the one that is there."""


def check_extra(what: str, extra: str) -> None:
    """Refuse what needs an optional part of the installation that is not there.

    Args:
        what: What needs it, for the error.
        extra: In `EXTRAS`.

    Raises:
        MechSearchError: Saying how to install it.
    """
    name, module = EXTRAS[extra]
    if importlib.util.find_spec(module) is not None:
        return
    command = _ALONE.get(extra)
    how = f"`{command}`" if command else (
        f"`pip install '.[{extra}]'` in the folder of mechsearch's pyproject.toml"
    )  # fmt: skip
    raise MechSearchError(f"{what} needs {name}: install it by {how}")


@runtime_checkable
class Policy(Protocol):
    """Anything that acts: the actor, a teacher, random, idle, or a user's own."""

    keys: tuple[str, ...]
    """Observation keys that the policy reads; it is handed no others."""

    def reset(self, rng: np.random.Generator) -> None:
        """Begin a new episode; all the policy's randomness comes from `rng`."""

    def act(self, obs: Observation) -> Array:
        """Return an action for one observation.

        It is a displacement (3,) in [-1, 1], in workspace axes, or, of a policy whose attribute
        `goal` is "retrieve", the vector (9,) of a decision. To one whose attribute `on_demand` is
        true an evaluation hands a mapping whose images are made when they are read, in `act`.
        """


_SHORT = Repr()
_SHORT.maxother = _SHORT.maxstring = 100


def shown(value: Any) -> str:
    """Return a value as errors show it: in one line, shortened."""
    return " ".join(_SHORT.repr(value).split())


def real_array(values: Any, expected: str) -> Array:
    """Return real numbers that somebody gave: an array, a sequence, a tensor of PyTorch.

    A tensor's gradient is left behind, and its device.

    Args:
        values: What was given.
        expected: What it should be, for errors.

    Raises:
        MechSearchError: If it is no array of real numbers.
    """
    if hasattr(values, "detach"):
        values = values.detach().cpu()
    try:
        array = np.asarray(values)
    except (TypeError, ValueError, RuntimeError) as error:
        raise MechSearchError(f"{expected}; got {shown(values)}: {shown(error)}") from None
    if array.dtype.kind not in "biuf":
        raise MechSearchError(f"{expected}; got {shown(values)}")
    return array


def finite_numbers(values: Any, shape: tuple[int, ...], expected: str) -> Floats:
    """Return finite numbers of a shape that somebody gave; see `real_array`.

    Raises:
        MechSearchError: If they are anything else.
    """
    array = real_array(values, expected)
    if array.shape != shape or not all(map(isfinite, array.ravel().tolist())):
        raise MechSearchError(f"{expected}; got shape {array.shape}: {shown(values)}")
    return np.asarray(array, np.float64)


def select(obs: Observation, keys: tuple[str, ...]) -> dict[str, Array]:
    """Return the part of an observation that one policy may read.

    Raises:
        MechSearchError: If a key is missing from the observation.
    """
    missing = [key for key in keys if key not in obs]
    if missing:
        hint = ". Privileged keys need an environment made with privileged=True"
        raise MechSearchError(
            f"the observation lacks {', '.join(missing)}; expected {', '.join(keys)}, and it has "
            f"{', '.join(sorted(map(str, obs))) or 'none'}"
            f"{hint if {*missing} & {*PRIVILEGED_KEYS} else ''}"
        )
    return {key: obs[key] for key in keys}
