"""Balls, blocks and other solid things."""

from functools import partial

import numpy as np
from numpy.typing import NDArray

from mechsearch.objects.household.containers import WHITE
from mechsearch.objects.household.paint import band, dots, layers, panel, plain, seam, spot
from mechsearch.objects.household.primitives import (
    Item,
    Paint,
    Solids,
    box,
    cylinder,
    ellipsoid,
    frustum,
)
from mechsearch.types import Floats


def ball(diameter: float, paint: Paint) -> Solids:
    """Return a ball."""
    return (ellipsoid(diameter, diameter, diameter).painted(paint),)


def stitched(ground: str, stitches: str, width: float = 0.06) -> Paint:
    """Return paint of a ball with one curved seam."""
    return layers(ground, (seam(width), stitches))


def dotted(ground: str, spots: str, count: int, cosine: float) -> Paint:
    """Return paint of a ball with evenly spread round spots."""
    return layers(ground, (dots(count, cosine), spots))


def block(x: float, y: float, z: float, paint: Paint) -> Solids:
    """Return a block of size x, y, z [m]."""
    return (box(x, y, z).painted(paint),)


def wood() -> Paint:
    """Return paint with the grain of a plank along z."""
    grain = [(band("x", at, at + 0.004), "a87441") for at in (-0.034, -0.019, -0.003, 0.013, 0.029)]
    rings = [(spot("z", 0.01, 0.005, r), c) for r, c in ((0.03, "a87441"), (0.024, "c89058"))]
    return layers("c89058", *grain, *rings)


def sponge() -> Paint:
    """Return paint of a sponge with a rough green side."""
    return layers("f2cf3b", (band("z", 0.002, 1.0), "3f8f4f"))


def cube_puzzle(side: float = 0.057) -> Solids:
    """Return a cube of 3 x 3 coloured squares on each side, turned out of order."""
    return (box(side, side, side, cells=6).painted(_squares(side)),)


def _squares(side: float) -> Paint:
    palette = ["f4f4f0", "f7d117", "c0272d", "f26b21", "1f5fbf", "159a4a"]
    rgb = np.array([list(bytes.fromhex(colour)) for colour in palette], np.uint8)

    def paint(points: Floats, normals: Floats) -> NDArray[np.uint8]:
        axis = np.abs(normals).argmax(axis=1)
        positive = normals[np.arange(len(normals)), axis] > 0
        cell = np.clip(np.floor((points / side + 0.5) * 3), 0, 2).astype(int)
        gap = np.abs((points / side + 0.5) * 3 - cell - 0.5) > 0.42
        gap[np.arange(len(axis)), axis] = False
        mixed = (cell @ [1, 2, 5] + 3 * axis + 2 * positive) * 7 % 11 % 6
        return np.where(gap.any(axis=1)[:, None], np.uint8(24), rgb[mixed])

    return paint


def brick(studs: tuple[int, int], height: float, colour: str, pitch: float = 0.0159) -> Solids:
    """Return a toy brick with studs along x and y that stand 4.5 mm proud."""
    across, along = studs
    paint = plain(colour)
    places = [
        ((i - (across - 1) / 2) * pitch, (j - (along - 1) / 2) * pitch)
        for i in range(across)
        for j in range(along)
    ]
    body = box(across * pitch, along * pitch, height, 1).painted(paint)
    stud = cylinder(0.0095, 0.0045, 8, 1).painted(paint)
    return (body, *(stud.moved(x, y, height / 2) for x, y in places))


def timer() -> Solids:
    """Return a kitchen timer of 85 x 80 x 40 mm with a raised dial."""
    hand = (panel("z", (-0.002, 0.002), (0.0, 0.020)), "d9362b")
    knob = (spot("z", 0.0, 0.0, 0.006), "d9362b")
    return (
        box(0.085, 0.080, 0.028, 1).painted(plain("2f6f73")).moved(z=0.014),
        frustum(0.056, 0.046, 0.012).painted(layers(WHITE, hand, knob)).moved(z=0.028),
    )


TOYS = (
    Item("soccer_ball", "ball", 123, partial(ball, 0.140, dotted("f4f4f0", "1d1f24", 12, 0.93))),
    Item("softball", "ball", 191, partial(ball, 0.096, stitched("d7e33f", "b3261e", 0.05))),
    Item("baseball", "ball", 138, partial(ball, 0.075, stitched("f3efe6", "b3261e"))),
    Item("tennis_ball", "ball", 58, partial(ball, 0.0647, stitched("c6df3a", "f4f4f0", 0.08))),
    Item("racquetball", "ball", 41, partial(ball, 0.0553, plain("2456b8"))),
    Item("golf_ball", "ball", 46, partial(ball, 0.0427, dotted("f6f6f3", "d5d6d4", 150, 0.994))),
    Item("wood_block", "block", 729, partial(block, 0.085, 0.085, 0.200, wood())),
    Item("foam_brick", "block", 28, partial(block, 0.050, 0.075, 0.050, plain("b5432e"))),
    Item("cube_puzzle", "block", 94, cube_puzzle),
    Item("long_brick", "block", 37.2, partial(brick, (4, 2), 0.0192, "2f7d32")),
    Item("square_brick", "block", 18.6, partial(brick, (2, 2), 0.0384, "f9c80e")),
    Item("sponge", "block", 6.2, partial(block, 0.072, 0.114, 0.014, sponge())),
    Item("timer", "appliance", 102, timer),
)
