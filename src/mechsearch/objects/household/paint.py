"""Colours for solids: layers of marks over a ground."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mechsearch.objects.household.primitives import Paint
from mechsearch.types import Floats

Mark = Callable[[Floats, Floats], NDArray[np.bool_]]
"""Which of the surface points (N, 3) [m], with outward normals (N, 3), a mark covers: (N,)."""


def plain(colour: str) -> Paint:
    """Return paint of one colour, written as six hexadecimal digits."""
    return layers(colour)


def layers(ground: str, *marks: tuple[Mark, str]) -> Paint:
    """Return paint of a ground colour under marks, each over those before it."""

    def paint(points: Floats, normals: Floats) -> NDArray[np.uint8]:
        colours = np.tile(_rgb(ground), (len(points), 1))
        for covers, colour in marks:
            colours[covers(points, normals)] = _rgb(colour)
        return colours.astype(np.uint8)

    return paint


def blend(first: str, second: str, axis: str, low: float, high: float) -> Paint:
    """Return paint that turns from one colour to another between two coordinates [m]."""

    def paint(points: Floats, normals: Floats) -> NDArray[np.uint8]:
        share = np.clip((points[:, _axis(axis)] - low) / (high - low), 0, 1)[:, None]
        return np.round((1 - share) * _rgb(first) + share * _rgb(second)).astype(np.uint8)

    return paint


def band(axis: str, low: float, high: float) -> Mark:
    """Mark what lies between two coordinates [m] along an axis."""
    index = _axis(axis)
    return lambda points, normals: (points[:, index] >= low) & (points[:, index] <= high)


def facing(axis: str) -> Mark:
    """Mark the surfaces that look along an axis, either way."""
    return lambda points, normals: np.abs(normals[:, _axis(axis)]) > 0.9


def spot(axis: str, across: float, along: float, radius: float) -> Mark:
    """Mark a disc on the surfaces that look along an axis, either way.

    Args:
        axis: The direction.
        across: Centre on the first of the two other axes, in alphabetical order [m].
        along: Centre on the second [m].
        radius: [m].
    """
    others = [i for i in range(3) if i != _axis(axis)]

    def covers(points: Floats, normals: Floats) -> NDArray[np.bool_]:
        distance = np.linalg.norm(points[:, others] - [across, along], axis=1)
        return np.asarray(facing(axis)(points, normals) & (distance <= radius))

    return covers


def panel(axis: str, across: tuple[float, float], along: tuple[float, float]) -> Mark:
    """Mark a rectangle, given as two intervals [m], on the surfaces that look along an axis."""
    first, second = (name for name in "xyz" if name != axis)
    return every(facing(axis), band(first, *across), band(second, *along))


def window(middle: float, width: float, low: float, high: float, turns: int = 2) -> Mark:
    """Mark equal patches round the vertical axis.

    Args:
        middle: Direction of the first patch [degrees].
        width: Angle of each patch [degrees].
        low: Bottom [m].
        high: Top [m].
        turns: Number of patches.
    """

    def covers(points: Floats, normals: Floats) -> NDArray[np.bool_]:
        angle = np.degrees(np.arctan2(points[:, 1], points[:, 0])) - middle
        period = 360 / turns
        near = np.abs((angle + period / 2) % period - period / 2) <= width / 2
        return np.asarray(near & band("z", low, high)(points, normals))

    return covers


def dots(count: int, cosine: float) -> Mark:
    """Mark round spots spread evenly over all directions from the origin.

    Args:
        count: Number of spots.
        cosine: Of each spot's angular radius.
    """
    rank = np.arange(count) + 0.5
    height, turn = 1 - 2 * rank / count, np.pi * (1 + 5**0.5) * rank
    level = np.sqrt(1 - height**2)
    centres = np.stack([level * np.cos(turn), level * np.sin(turn), height])

    def covers(points: Floats, normals: Floats) -> NDArray[np.bool_]:
        return np.asarray((_directions(points) @ centres).max(axis=1) >= cosine)

    return covers


def seam(width: float) -> Mark:
    """Mark the closed curve that halves a baseball, of a relative width."""

    def covers(points: Floats, normals: Floats) -> NDArray[np.bool_]:
        x, y, z = _directions(points).T
        return np.asarray(np.abs(z - 1.2 * (x**2 - y**2)) <= width)

    return covers


def every(*marks: Mark) -> Mark:
    """Mark what all of the given marks cover."""
    return lambda points, normals: np.all([mark(points, normals) for mark in marks], axis=0)


def _directions(points: Floats) -> Floats:
    lengths = np.linalg.norm(points, axis=1, keepdims=True)
    return np.asarray(points / np.maximum(lengths, 1e-9))


def _axis(name: str) -> int:
    return "xyz".index(name)


def _rgb(colour: str) -> Floats:
    return np.array(list(bytes.fromhex(colour)), np.float64)
