"""Rigid transforms and quaternions. A pose is (7,): position [m], unit quaternion (w, x, y, z)."""

from math import sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mechsearch.types import Floats


def _rotation_terms() -> tuple[NDArray[np.intp], Floats]:
    """Return which products (4, 9) of a quaternion's entries make its matrix, with which weights.

    Of the 16 products at most 4 contribute to an entry; those that fill up to 4 weigh nothing.
    """
    terms = np.zeros((4, 4, 3, 3))
    for i in range(3):
        terms[0, 0, i, i] = 1.0
        for j in range(3):
            terms[i + 1, i + 1, j, j] += 1.0 if i == j else -1.0
            if i != j:
                terms[i + 1, j + 1, i, j] += 2.0
    for row, column, axis in ((2, 1, 1), (0, 2, 2), (1, 0, 3)):
        terms[0, axis, row, column] += 2.0
        terms[0, axis, column, row] -= 2.0
    weights = terms.reshape(16, 9)
    which = np.argsort(weights == 0.0, axis=0, kind="stable")[:4]
    return which, np.take_along_axis(weights, which, axis=0)


_PRODUCTS, _WEIGHTS = _rotation_terms()


def rotation_from_quaternion(quaternion: ArrayLike) -> Floats:
    """Return rotation matrices (..., 3, 3) of unit quaternions (..., 4), scalar first.

    Each has the same bits whatever others are asked for with it.
    """
    q = np.asarray(quaternion, dtype=np.float64)
    products = (q[..., :, None] * q[..., None, :]).reshape(*q.shape[:-1], 16)
    # A matrix product would round a single one otherwise than one of many.
    rotations: Floats = (products.take(_PRODUCTS, axis=-1) * _WEIGHTS).sum(axis=-2)
    return rotations.reshape(*q.shape[:-1], 3, 3)


def quaternion_from_rotation(rotation: Floats) -> Floats:
    """Return the unit quaternion (4,), scalar first, of a rotation matrix (3, 3)."""
    # Rows of 4 q q^T - I, from the entries of the matrix (Bar-Itzhack, 2000).
    r = rotation
    outer = np.array(
        [
            [r[0, 0] + r[1, 1] + r[2, 2], 0, 0, 0],
            [r[2, 1] - r[1, 2], r[0, 0] - r[1, 1] - r[2, 2], 0, 0],
            [r[0, 2] - r[2, 0], r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], 0],
            [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1]],
        ]
    )
    q: Floats = np.linalg.eigh(outer)[1][:, -1]
    return q if q[0] >= 0 else -q


def quaternion_product(left: ArrayLike, right: ArrayLike) -> Floats:
    """Return the Hamilton products (..., 4) of quaternions: rotate by `right`, then by `left`."""
    a, b = np.broadcast_arrays(np.asarray(left, np.float64), np.asarray(right, np.float64))
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def random_quaternion(rng: np.random.Generator) -> Floats:
    """Return a quaternion (4,) drawn uniformly from all rotations (Shoemake, 1992)."""
    u, v, w = rng.random(3)
    a, b = np.sqrt(1 - u), np.sqrt(u)
    return np.array(
        [
            a * np.sin(2 * np.pi * v),
            a * np.cos(2 * np.pi * v),
            b * np.sin(2 * np.pi * w),
            b * np.cos(2 * np.pi * w),
        ]
    )


def yaw_quaternion(angle: float) -> Floats:
    """Return the quaternion (4,) of a rotation by `angle` [rad] about the vertical axis."""
    return np.array([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])


def transform_from_pose(pose: ArrayLike) -> Floats:
    """Return the homogeneous matrix (4, 4) of a pose (7,)."""
    p = np.asarray(pose, dtype=np.float64)
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_from_quaternion(p[3:])
    matrix[:3, 3] = p[:3]
    return matrix


def invert(transform: ArrayLike) -> Floats:
    """Return the inverse (4, 4) of a rigid transform."""
    matrix = np.asarray(transform, dtype=np.float64)
    inverse = np.eye(4)
    inverse[:3, :3] = matrix[:3, :3].T
    inverse[:3, 3] = -matrix[:3, :3].T @ matrix[:3, 3]
    return inverse


def apply(transform: ArrayLike, points: ArrayLike) -> Floats:
    """Return points (..., 3) moved by a rigid transform (4, 4)."""
    matrix = np.asarray(transform, dtype=np.float64)
    moved: NDArray[np.float64] = np.asarray(points, np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    return moved


def cap_length(vector: ArrayLike, limit: float) -> Floats:
    """Return the vector (3,), shortened to `limit` where it is longer."""
    v = np.asarray(vector, dtype=np.float64)
    length = sqrt(float(v @ v))
    return v if length <= limit else v * (limit / length)
