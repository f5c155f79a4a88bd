"""Household things that hold others: cans, cartons, bottles, bowls, mugs and cups."""

from functools import partial

from mechsearch.objects.household.paint import band, layers, panel, plain, spot, window
from mechsearch.objects.household.primitives import (
    Item,
    Solids,
    box,
    cylinder,
    fitted,
    frustum,
    prism,
    shell,
    tube,
)

TIN = "b9bcc0"
WHITE = "f4f1ea"


def can(diameter: float, height: float, ground: str, stripe: str, mark: str) -> Solids:
    """Return an upright tin with a wrap-around label: a stripe and two marks on a ground."""
    paint = layers(
        ground,
        (band("z", 0.30 * height, 0.62 * height), stripe),
        (window(-90, 56, 0.36 * height, 0.56 * height), mark),
        (window(-90, 40, 0.70 * height, 0.84 * height), stripe),
        (band("z", -1.0, 0.03 * height), TIN),
        (band("z", 0.97 * height, 1.0), TIN),
    )
    return (cylinder(diameter, height, bands=10).painted(paint),)


def loaf_can(x: float, y: float, z: float) -> Solids:
    """Return a can of rounded rectangular section: a box with clipped edges."""
    clip = 0.22 * min(x, y)
    paint = layers(
        "1f4e9c",
        (band("z", 0.25 * z, 0.55 * z), "f2c230"),
        (panel("y", (-0.34 * x, 0.34 * x), (0.62 * z, 0.84 * z)), WHITE),
        (band("z", -1.0, 0.04 * z), TIN),
        (band("z", 0.96 * z, 1.0), TIN),
    )
    corners = [
        (side * x / 2 - side * dx, end * y / 2 - end * dy)
        for side, end, order in ((1, 1, 1), (-1, 1, -1), (-1, -1, 1), (1, -1, -1))
        for dx, dy in ((0.0, clip), (clip, 0.0))[::order]
    ]
    return (prism(corners, z, bands=10, cells=4).painted(paint),)


def carton(x: float, y: float, z: float, ground: str, field: str, mark: str) -> Solids:
    """Return an upright box of size x, y, z [m] with a printed field and a round mark."""
    thin = "x" if x <= y else "y"
    width = max(x, y)
    paint = layers(
        ground,
        (panel(thin, (-0.38 * width, 0.38 * width), (-0.36 * z, 0.08 * z)), field),
        (spot(thin, 0, -0.14 * z, 0.15 * min(width, z)), mark),
        (panel(thin, (-0.38 * width, 0.38 * width), (0.2 * z, 0.36 * z)), WHITE),
        (panel("y" if thin == "x" else "x", (-1, 1), (-0.3 * z, -0.1 * z)), field),
        (panel("z", (-0.2 * x, 0.2 * x), (-0.36 * y, 0.36 * y)), field),
    )
    return (box(x, y, z, cells=6).painted(paint),)


def mustard_bottle() -> Solids:
    """Return a squeeze bottle with an oval body and a pointed spout."""
    oval = 0.050 / 0.085
    label = layers(
        "f0b41c", (window(-90, 120, 0.030, 0.090), "8c1d18"), (window(-90, 76, 0.052, 0.070), WHITE)
    )
    body = frustum(0.078, 0.085, 0.105, bands=12).painted(label)
    shoulder = frustum(0.085, 0.036, 0.030).painted(plain("f0b41c"))
    return (
        body.scaled(y=oval),
        shoulder.scaled(y=oval).moved(z=0.105),
        cylinder(0.030, 0.014, 8).painted(plain("e0301e")).moved(z=0.135),
        frustum(0.018, 0.006, 0.026, 8).painted(plain("e0301e")).moved(z=0.149),
    )


def bleach_bottle() -> Solids:
    """Return a bottle with an oval body, a neck to one side and a grip with an opening."""
    white = plain(WHITE)
    label = layers(
        WHITE, (window(-90, 130, 0.025, 0.120), "1c5fa8"), (window(-90, 90, 0.060, 0.095), "f0c419")
    )
    grip = tube(
        [(0.030, 0.128), (0.040, 0.165), (0.028, 0.196), (-0.006, 0.208)],
        [0.024, 0.020, 0.020, 0.022],
        [0.034, 0.024, 0.024, 0.030],
    )
    oval = 0.065 / 0.098
    solids = (
        cylinder(0.098, 0.135).painted(label).scaled(y=oval),
        frustum(0.098, 0.060, 0.022, 12).painted(white).scaled(y=oval).moved(-0.003, z=0.135),
        frustum(0.046, 0.030, 0.070, 12).painted(white).moved(-0.018, z=0.150),
        cylinder(0.034, 0.032, 12).painted(plain("1c5fa8")).moved(-0.018, z=0.218),
        *(piece.turned("x", 90).painted(white) for piece in grip),
    )
    return fitted(solids, 0.098, 0.065, 0.250)


def bowl() -> Solids:
    """Return a bowl of 159 x 53 mm."""
    red = plain("c8371f")
    wall = shell(
        [(0.030, 0.006), (0.0745, 0.053)], [(0.0795, 0.053), (0.068, 0.028), (0.034, 0.0)], 9
    )
    inside = layers("c8371f", (band("z", 0.049, 0.06), "7d1a10"))
    base = cylinder(0.065, 0.007, 9, 1).painted(red)
    return (*(piece.painted(inside) for piece in wall), base)


def mug() -> Solids:
    """Return a mug of 80 x 82 mm with a handle that a finger goes through."""
    red = layers("b3261e", (band("z", 0.0, 0.004), "efe7dc"), (band("z", 0.0795, 0.09), "efe7dc"))
    wall = shell([(0.0355, 0.0), (0.0365, 0.082)], [(0.040, 0.082), (0.040, 0.0)], 7)
    handle = tube(
        [(0.036, 0.066), (0.063, 0.062), (0.061, 0.024), (0.036, 0.016)],
        [0.010, 0.010, 0.010, 0.010],
        [0.014, 0.014, 0.014, 0.014],
    )
    return (
        *(piece.painted(red).turned("z", 180 / 7) for piece in wall),
        cylinder(0.074, 0.006, 14, 1).painted(plain("efe7dc")),
        *(piece.turned("x", 90).painted(plain("b3261e")) for piece in handle),
    )


def cup(diameter: float, height: float, colour: str) -> Solids:
    """Return a tapered cup of a diameter at the rim and a height [m]."""
    rim, foot, wall = diameter / 2, 0.39 * diameter, 0.003
    sides = shell([(foot - wall, 0.0), (rim - wall, height)], [(rim, height), (foot, 0.0)], 8)
    return (
        *(piece.painted(plain(colour)) for piece in sides),
        cylinder(2 * foot - wall, 0.004, 8, 1).painted(plain(colour)),
    )


def wine_glass() -> Solids:
    """Return a stemmed glass of 89 x 137 mm."""
    pale = plain("bcd3da")
    wall = shell(
        [(0.012, 0.074), (0.040, 0.137)], [(0.0435, 0.137), (0.0445, 0.112), (0.016, 0.068)], 8
    )
    return (
        *(piece.painted(pale) for piece in wall),
        frustum(0.012, 0.034, 0.072, 8).painted(pale).moved(z=0.004),
        frustum(0.070, 0.064, 0.004, 12, 1).painted(pale),
    )


def pitcher_lid() -> Solids:
    """Return a lid of 123 x 48 mm with a bar to hold it by."""
    blue = plain("2b6cb0")
    return (
        frustum(0.108, 0.123, 0.024).painted(blue),
        cylinder(0.123, 0.006, bands=1).painted(plain("245a94")).moved(z=0.024),
        box(0.090, 0.020, 0.020, 1).painted(blue).moved(z=0.038),
    )


CONTAINERS = (
    Item("coffee_can", "can", 414, partial(can, 0.102, 0.139, "1d3f72", "c8952b", "f4f1ea")),
    Item("soup_can", "can", 349, partial(can, 0.066, 0.101, "c4161c", "f4f1ea", "c9a227")),
    Item("tuna_can", "can", 171, partial(can, 0.085, 0.033, "1f6f8b", "f4f1ea", "e4572e")),
    Item("chips_can", "can", 205, partial(can, 0.075, 0.250, "b8202a", "e9b824", "2b2d31")),
    Item("meat_can", "can", 370, partial(loaf_can, 0.097, 0.050, 0.082)),
    Item(
        "cracker_box",
        "box",
        411,
        partial(carton, 0.060, 0.158, 0.210, "c1272d", "f2b632", "8c4a1f"),
    ),
    Item(
        "sugar_box", "box", 514, partial(carton, 0.038, 0.089, 0.175, "f2d33b", "f4f1ea", "1c5fa8")
    ),
    Item(
        "pudding_box",
        "box",
        187,
        partial(carton, 0.110, 0.035, 0.089, "5a3320", "e8c9a0", "c1272d"),
    ),
    Item(
        "gelatin_box", "box", 97, partial(carton, 0.085, 0.028, 0.073, "c2185b", "f4f1ea", "e53935")
    ),
    Item("mustard_bottle", "bottle", 603, mustard_bottle),
    Item("bleach_bottle", "bottle", 1131, bleach_bottle),
    Item("bowl", "bowl", 147, bowl),
    Item("mug", "mug", 118, mug),
    Item("wine_glass", "cup", 133, wine_glass),
    Item("cup_a", "cup", 13, partial(cup, 0.055, 0.060, "c0392b")),
    Item("cup_c", "cup", 17, partial(cup, 0.065, 0.064, "2e86c1")),
    Item("cup_e", "cup", 21, partial(cup, 0.075, 0.068, "239b56")),
    Item("cup_g", "cup", 28, partial(cup, 0.085, 0.072, "d68910")),
    Item("cup_i", "cup", 35, partial(cup, 0.095, 0.076, "8e44ad")),
    Item("pitcher_lid", "lid", 66, pitcher_lid),
)
