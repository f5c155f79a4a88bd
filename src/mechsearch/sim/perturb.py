"""How far an executed grasp is from the planned one: errors of place, direction and friction."""

from dataclasses import dataclass

import numpy as np

from mechsearch.geometry import quaternion_product, rotation_from_quaternion
from mechsearch.types import Array, Floats


@dataclass(frozen=True)
class Perturbation:
    """Spreads of what is uncertain; the values are Dex-Net's where it states them.

    Attributes:
        translation: Standard deviation along each axis [m].
        rotation: Standard deviation about each axis of the gripper [rad].
        friction: Mean sliding coefficient.
        friction_spread: Its standard deviation; draws are kept in [0.05, 1].
    """

    translation: float = 0.005
    rotation: float = float(np.deg2rad(3.0))
    friction: float = 0.5
    friction_spread: float = 0.1


def perturbed(grasp: Array, rng: np.random.Generator, spread: Perturbation) -> tuple[Floats, float]:
    """Return a grasp (7,) near the planned one, and the friction of its fingers."""
    pose = np.array(grasp, np.float64)
    pose[:3] += rotation_from_quaternion(pose[3:]) @ rng.normal(0.0, spread.translation, 3)
    half = rng.normal(0.0, spread.rotation, 3) / 2
    turn = np.array([1.0, *half])
    pose[3:] = quaternion_product(pose[3:], turn / np.linalg.norm(turn))
    friction = -1.0
    while not 0.05 <= friction <= 1.0:
        friction = float(rng.normal(spread.friction, spread.friction_spread))
    return pose, friction
