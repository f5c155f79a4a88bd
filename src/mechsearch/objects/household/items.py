"""What is in the built-in set: containers, fruit, tools, balls, blocks and other things."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from mechsearch.objects.household.paint import (
    Mark,
    band,
    blend,
    dots,
    layers,
    panel,
    plain,
    seam,
    spot,
    window,
)
from mechsearch.objects.household.primitives import (
    Paint,
    Solid,
    Solids,
    box,
    cylinder,
    ellipsoid,
    fitted,
    frustum,
    prism,
    shell,
    stack,
    tube,
)
from mechsearch.types import Floats

HouseholdItem = tuple[str, str, float, Solids]
"""Name, category, mass [g] and convex solids of one object."""

TIN = "b9bcc0"
CREAM = "f4f1ea"
STALK = "5b3d1e"
STEEL = "a9adb3"
DARK = "2b2d31"
BRASS = "c9a24a"


def items() -> Iterator[HouseholdItem]:
    """Yield every object of the set, in its order."""
    yield from _containers()
    yield from _fruit()
    yield from _tools()
    yield from _toys()


def _containers() -> Iterator[HouseholdItem]:
    yield "coffee_can", "can", 414, _can(0.102, 0.139, "1d3f72", "c8952b", "f4f1ea")
    yield "soup_can", "can", 349, _can(0.066, 0.101, "c4161c", "f4f1ea", "c9a227")
    yield "tuna_can", "can", 171, _can(0.085, 0.033, "1f6f8b", "f4f1ea", "e4572e")
    yield "chips_can", "can", 205, _can(0.075, 0.250, "b8202a", "e9b824", "2b2d31")
    yield "meat_can", "can", 370, _loaf_can(0.097, 0.050, 0.082)
    cracker = _carton(0.060, 0.158, 0.210, "c1272d", "f2b632", "8c4a1f")
    yield "cracker_box", "box", 411, cracker
    yield "sugar_box", "box", 514, _carton(0.038, 0.089, 0.175, "f2d33b", "f4f1ea", "1c5fa8")
    yield "pudding_box", "box", 187, _carton(0.110, 0.035, 0.089, "5a3320", "e8c9a0", "c1272d")
    yield "gelatin_box", "box", 97, _carton(0.085, 0.028, 0.073, "c2185b", "f4f1ea", "e53935")

    # A squeeze bottle with an oval body and a pointed spout.
    yellow, red, oval = plain("f0b41c"), plain("e0301e"), 0.050 / 0.085
    mark = window(-90, 120, 0.030, 0.090), "8c1d18"
    label = layers("f0b41c", mark, (window(-90, 76, 0.052, 0.070), CREAM))
    mustard = (
        frustum(0.078, 0.085, 0.105, bands=12).painted(label).scaled(y=oval),
        frustum(0.085, 0.036, 0.030).painted(yellow).scaled(y=oval).moved(z=0.105),
        cylinder(0.030, 0.014, 8).painted(red).moved(z=0.135),
        frustum(0.018, 0.006, 0.026, 8).painted(red).moved(z=0.149),
    )
    yield "mustard_bottle", "bottle", 603, mustard

    # One with an oval body, a neck to one side and a grip with an opening.
    white, blue, oval = plain(CREAM), plain("1c5fa8"), 0.065 / 0.098
    mark = window(-90, 130, 0.025, 0.120), "1c5fa8"
    label = layers(CREAM, mark, (window(-90, 90, 0.060, 0.095), "f0c419"))
    path = [(0.030, 0.128), (0.040, 0.165), (0.028, 0.196), (-0.006, 0.208)]
    grip = tube(path, [0.024, 0.020, 0.020, 0.022], [0.034, 0.024, 0.024, 0.030])
    bleach = (
        cylinder(0.098, 0.135).painted(label).scaled(y=oval),
        frustum(0.098, 0.060, 0.022, 12).painted(white).scaled(y=oval).moved(-0.003, z=0.135),
        frustum(0.046, 0.030, 0.070, 12).painted(white).moved(-0.018, z=0.150),
        cylinder(0.034, 0.032, 12).painted(blue).moved(-0.018, z=0.218),
        *(piece.turned("x", 90).painted(white) for piece in grip),
    )
    yield "bleach_bottle", "bottle", 1131, fitted(bleach, 0.098, 0.065, 0.250)

    outside = [(0.0795, 0.053), (0.068, 0.028), (0.034, 0.0)]
    wall = shell([(0.030, 0.006), (0.0745, 0.053)], outside, 9)
    inside = layers("c8371f", (band("z", 0.049, 0.06), "7d1a10"))
    base = cylinder(0.065, 0.007, 9, 1).painted(plain("c8371f"))
    yield "bowl", "bowl", 147, (*_painted(wall, inside), base)

    # A finger goes through the handle.
    rims = (band("z", 0.0, 0.004), "efe7dc"), (band("z", 0.0795, 0.09), "efe7dc")
    wall = shell([(0.0355, 0.0), (0.0365, 0.082)], [(0.040, 0.082), (0.040, 0.0)], 7)
    path = [(0.036, 0.066), (0.063, 0.062), (0.061, 0.024), (0.036, 0.016)]
    mug = (
        *(piece.turned("z", 180 / 7) for piece in _painted(wall, layers("b3261e", *rims))),
        cylinder(0.074, 0.006, 14, 1).painted(plain("efe7dc")),
        *(
            piece.turned("x", 90).painted(plain("b3261e"))
            for piece in tube(path, [0.010] * 4, [0.014] * 4)
        ),
    )
    yield "mug", "mug", 118, mug

    pale = plain("bcd3da")
    outside = [(0.0435, 0.137), (0.0445, 0.112), (0.016, 0.068)]
    glass = (
        *_painted(shell([(0.012, 0.074), (0.040, 0.137)], outside, 8), pale),
        frustum(0.012, 0.034, 0.072, 8).painted(pale).moved(z=0.004),
        frustum(0.070, 0.064, 0.004, 12, 1).painted(pale),
    )
    yield "wine_glass", "cup", 133, glass
    yield "cup_a", "cup", 13, _cup(0.055, 0.060, "c0392b")
    yield "cup_c", "cup", 17, _cup(0.065, 0.064, "2e86c1")
    yield "cup_e", "cup", 21, _cup(0.075, 0.068, "239b56")
    yield "cup_g", "cup", 28, _cup(0.085, 0.072, "d68910")
    yield "cup_i", "cup", 35, _cup(0.095, 0.076, "8e44ad")

    # With a bar to hold it by.
    lid = (
        frustum(0.108, 0.123, 0.024).painted(plain("2b6cb0")),
        cylinder(0.123, 0.006, bands=1).painted(plain("245a94")).moved(z=0.024),
        box(0.090, 0.020, 0.020, 1).painted(plain("2b6cb0")).moved(z=0.038),
    )
    yield "pitcher_lid", "lid", 66, lid


def _can(diameter: float, height: float, ground: str, stripe: str, mark: str) -> Solids:
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


def _loaf_can(x: float, y: float, z: float) -> Solids:
    """Return a can of rounded rectangular section: a box with clipped edges."""
    clip = 0.22 * min(x, y)
    paint = layers(
        "1f4e9c",
        (band("z", 0.25 * z, 0.55 * z), "f2c230"),
        (panel("y", (-0.34 * x, 0.34 * x), (0.62 * z, 0.84 * z)), CREAM),
        (band("z", -1.0, 0.04 * z), TIN),
        (band("z", 0.96 * z, 1.0), TIN),
    )
    corners = [
        (side * x / 2 - side * dx, end * y / 2 - end * dy)
        for side, end, order in ((1, 1, 1), (-1, 1, -1), (-1, -1, 1), (1, -1, -1))
        for dx, dy in ((0.0, clip), (clip, 0.0))[::order]
    ]
    return (prism(corners, z, bands=10, cells=4).painted(paint),)


def _carton(x: float, y: float, z: float, ground: str, field: str, mark: str) -> Solids:
    """Return an upright box of size x, y, z [m] with a printed field and a round mark."""
    thin, broad = ("x", "y") if x <= y else ("y", "x")
    width = max(x, y)
    paint = layers(
        ground,
        (panel(thin, (-0.38 * width, 0.38 * width), (-0.36 * z, 0.08 * z)), field),
        (spot(thin, 0, -0.14 * z, 0.15 * min(width, z)), mark),
        (panel(thin, (-0.38 * width, 0.38 * width), (0.2 * z, 0.36 * z)), CREAM),
        (panel(broad, (-1, 1), (-0.3 * z, -0.1 * z)), field),
        (panel("z", (-0.2 * x, 0.2 * x), (-0.36 * y, 0.36 * y)), field),
    )
    return (box(x, y, z, cells=6).painted(paint),)


def _cup(diameter: float, height: float, colour: str) -> Solids:
    """Return a tapered cup of a diameter at the rim and a height [m]."""
    rim, foot, wall = diameter / 2, 0.39 * diameter, 0.003
    sides = shell([(foot - wall, 0.0), (rim - wall, height)], [(rim, height), (foot, 0.0)], 8)
    return _painted((*sides, cylinder(2 * foot - wall, 0.004, 8, 1)), plain(colour))


def _fruit() -> Iterator[HouseholdItem]:
    path = [(-0.095, 0.034), (-0.074, 0.018), (-0.032, 0.0)]
    path += [(0.020, 0.0), (0.066, 0.016), (0.088, 0.036)]
    widths = [0.010, 0.026, 0.036, 0.037, 0.030, 0.012]
    skin = layers("efcf2f", (band("x", -1, -0.088), STALK), (band("x", 0.082, 1), "3a2a16"))
    banana = fitted(_painted(tube(path, widths, widths), skin), 0.190, 0.060, 0.036)
    yield "banana", "fruit", 66, banana

    profile = [(0.010, -0.029), (0.022, -0.022), (0.037, -0.008), (0.0438, 0.005)]
    profile += [(0.041, 0.013), (0.031, 0.019), (0.014, 0.022)]
    seeds = layers("d3212c", (dots(60, 0.994), "f0c85a"))
    leaves = frustum(0.036, 0.018, 0.006, 8, 1).painted(plain("3f8f2f")).moved(z=0.020)
    yield "strawberry", "fruit", 18, (*_painted(stack(profile), seeds), leaves)

    skin = blend("c2182b", "d9a52e", "z", 0.0, 0.045)
    yield "apple", "fruit", 68, _round(0.075, 0.075, 0.069, skin, stalk=0.012)

    yellow = plain("f2d024")
    tip = frustum(0.020, 0.007, 0.010, 8, 2).painted(plain("e0b81c")).moved(z=0.0265)
    lemon = (
        ellipsoid(0.062, 0.054, 0.054).painted(yellow),
        tip.turned("y", 90).moved(-0.0025),
        tip.turned("y", -90).moved(0.0025),
    )
    yield "lemon", "fruit", 29, lemon

    skin = blend("f4b35a", "d9503f", "x", -0.02, 0.025)
    yield "peach", "fruit", 33, _round(0.059, 0.059, 0.057, skin)

    profile = [(0.022, -0.031), (0.046, -0.024), (0.0625, -0.012), (0.0662, 0.0), (0.060, 0.014)]
    profile += [(0.041, 0.036), (0.034, 0.050), (0.014, 0.060)]
    flesh = _painted(stack(profile), blend("7fa33a", "c9c04a", "z", -0.02, 0.05))
    stem = cylinder(0.004, 0.009, 6, 1).moved(z=0.060).painted(plain(STALK))
    yield "pear", "fruit", 49, (*flesh, stem)

    pores = layers("ee8a1d", (dots(200, 0.9995), "d97812"), (band("z", 0.0352, 1.0), "3c6b2a"))
    yield "orange", "fruit", 47, _round(0.073, 0.073, 0.071, pores)

    skin = blend("4a1838", "7d2a55", "z", -0.02, 0.02)
    yield "plum", "fruit", 25, _round(0.052, 0.052, 0.050, skin, stalk=0.006)


def _round(x: float, y: float, z: float, paint: Paint, stalk: float = 0.0) -> Solids:
    """Return an ellipsoid with diameters x, y, z [m] and, if long, a stalk [m]."""
    body = ellipsoid(x, y, z).painted(paint)
    if not stalk:
        return (body,)
    stem = cylinder(0.004, stalk + 0.004, 6, 1).painted(plain(STALK))
    return (body, stem.moved(z=z / 2 - 0.004))


def _tools() -> Iterator[HouseholdItem]:
    steel, dark = plain(STEEL), plain(DARK)
    # Of all cutlery, along x from -0.100 to 0.024 m, two pieces arched upwards.
    path = [(-0.100, 0.004), (-0.050, 0.007), (0.024, 0.003)]
    grip = tube(path, [0.007, 0.008, 0.005], [0.015, 0.014, 0.007])
    handle = [piece.turned("x", 90).painted(plain("3a6ea5")) for piece in grip]

    palm = [(0.010, -0.003), (0.040, -0.010), (0.052, -0.010)]
    blade = prism([*palm, *((x, -y) for x, y in palm[::-1])], 0.004).moved(z=0.001)
    prongs = [box(0.050, 0.004, 0.003, 1).moved(0.073, y, 0.003) for y in (-0.008, 0.0, 0.008)]
    fork = fitted([*handle, *_painted([blade, *prongs], steel)], 0.198, 0.024, 0.014)
    yield "fork", "cutlery", 34, fork

    outside = [(0.020, 0.0105), (0.015, 0.003), (0.007, 0.0)]
    hollow = [*shell([(0.006, 0.002), (0.0185, 0.0105)], outside, 6), cylinder(0.014, 0.0025, 6, 1)]
    head = [piece.scaled(x=1.75).moved(0.060, z=-0.006).painted(steel) for piece in hollow]
    yield "spoon", "cutlery", 30, fitted([*handle, *head], 0.195, 0.040, 0.020)

    edge = [(0.008, -0.006), (0.095, -0.010), (0.112, -0.004), (0.115, 0.008), (0.008, 0.006)]
    blade = prism(edge, 0.003).moved(z=0.001).painted(steel)
    yield "knife", "cutlery", 31, fitted([*handle, blade], 0.215, 0.020, 0.014)

    body = layers("d8472b", (band("z", 0.0, 0.016), DARK), (band("z", 0.098, 0.118), DARK))
    outline = [(-0.030, 0.026), (0.006, 0.026), (0.000, 0.140), (-0.044, 0.140)]
    drill = (
        cylinder(0.057, 0.118).painted(body).turned("y", 90).moved(-0.072, 0, 0.1555),
        frustum(0.042, 0.022, 0.070, 12).painted(dark).turned("y", 90).moved(0.045, 0, 0.1555),
        prism(outline, 0.036).moved(z=-0.018).turned("x", 90).painted(dark),
        box(0.082, 0.056, 0.030, 2).moved(0.0, 0.0, 0.015).painted(plain("d8472b")),
    )
    yield "power_drill", "tool", 895, fitted(drill, 0.184, 0.050, 0.160)

    # Open: two blades and two loops.
    loop = [(-0.016, -0.006), (-0.060, -0.005), (-0.095, -0.018), (-0.088, -0.040)]
    loop += [(-0.048, -0.034), (-0.020, -0.009)]
    rings = _painted(tube(loop, [0.009] * 6, [0.009] * 6), plain("d9541e"))
    blade = prism([(-0.022, -0.009), (0.030, -0.004), (0.102, 0.010), (0.030, 0.012)], 0.0035)
    lower = [blade.painted(steel).moved(z=-0.0035), *rings]
    pivot = cylinder(0.010, 0.010, 8, 1).moved(0.0, 0.0, -0.005).painted(dark)
    scissors = [*lower, *(piece.turned("x", 180) for piece in lower), pivot]
    yield "scissors", "tool", 82, fitted(scissors, 0.200, 0.087, 0.014)

    tip = frustum(0.006, 0.002, 0.012, 6, 1).moved(z=-0.006)
    yield "cross_screwdriver", "tool", 97, _screwdriver("d9a520", tip)
    yield "flat_screwdriver", "tool", 98.4, _screwdriver("2e6fb7", box(0.008, 0.002, 0.012, 1))

    # Adjustable, with its jaws as good as closed.
    bar = [(-0.100, -0.010), (-0.090, -0.013), (0.050, -0.009), (0.050, 0.009), (-0.090, 0.013)]
    jaw = [(0.042, -0.018), (0.056, -0.030), (0.072, -0.028), (0.074, 0.018), (0.050, 0.020)]
    fixed = [(0.068, -0.029), (0.100, -0.016), (0.105, -0.006), (0.072, -0.006)]
    sliding = [(0.068, 0.009), (0.098, 0.009), (0.092, 0.020), (0.070, 0.025)]
    wrench = (
        prism([*bar, (-0.100, 0.010)], 0.009).moved(z=-0.0045).painted(steel),
        prism(jaw, 0.014).moved(z=-0.007).painted(steel),
        prism(fixed, 0.012).moved(z=-0.006).painted(plain("90949a")),
        prism(sliding, 0.012).moved(z=-0.006).painted(plain("90949a")),
        cylinder(0.012, 0.016, 8, 1).moved(0.058, 0.010, -0.008).painted(dark),
    )
    yield "wrench", "tool", 252, wrench

    face = layers(BRASS, (panel("z", (-0.012, 0.012), (-0.026, -0.012)), DARK))
    half = [(-0.016, 0.004), (-0.016, 0.016), (-0.009, 0.027)]
    shackle = tube([*half, *((-x, y) for x, y in half[::-1])], [0.008] * 6, [0.008] * 6)
    case = box(0.047, 0.038, 0.024).moved(y=-0.014).painted(face)
    padlock = fitted([case, *_painted(shackle, plain("c9ccd1"))], 0.047, 0.065, 0.024)
    yield "padlock", "tool", 208, padlock

    yield "large_marker", "tool", 15.8, _felt_pen(0.018, 0.121, "1b1b1e")
    yield "small_marker", "tool", 8.2, _felt_pen(0.010, 0.135, "b3261e")
    yield "small_clamp", "clamp", 19.2, _clamp(0.085, 0.065, 0.010)
    yield "medium_clamp", "clamp", 59, _clamp(0.115, 0.090, 0.027)
    yield "large_clamp", "clamp", 125, _clamp(0.165, 0.125, 0.032)
    yield "extra_large_clamp", "clamp", 202, _clamp(0.213, 0.165, 0.037)


def _screwdriver(colour: str, tip: Solid) -> Solids:
    """Return a screwdriver of 215 mm."""
    grip = layers(colour, *((window(30 * k, 8, 0.012, 0.080, 1), DARK) for k in range(12)))
    steel = plain(STEEL)
    return (
        frustum(0.026, 0.031, 0.060, 12).painted(grip),
        frustum(0.031, 0.022, 0.032, 12).painted(plain(colour)).moved(z=0.060),
        cylinder(0.0065, 0.113, 8, 1).painted(steel).moved(z=0.090),
        tip.painted(steel).moved(z=0.209),
    )


def _clamp(length: float, width: float, thick: float) -> Solids:
    """Return a spring clamp: two arms that part at the handles and meet at the jaws."""
    arm = 0.085 * length
    path = [
        (-0.5 * length, 0.5 * width - 0.5 * arm),
        (0.02 * length, 0.62 * arm),
        (0.28 * length, 0.24 * width),
        (0.48 * length, 0.52 * arm),
    ]
    side = tube(path, [arm, 1.2 * arm, arm, 0.9 * arm], [thick, thick, thick, 0.8 * thick])
    upper = _painted(side, layers(DARK, (band("x", -length, -0.30 * length), "e8641b")))
    pivot = cylinder(2.2 * arm, 0.9 * thick, 10, 1).moved(0.02 * length, 0, -0.45 * thick)
    lower = [piece.turned("x", 180) for piece in upper]
    return fitted([*upper, *lower, pivot.painted(plain(STEEL))], length, width, thick)


def _felt_pen(diameter: float, length: float, colour: str) -> Solids:
    """Return a felt pen with its cap on."""
    barrel = layers("e9e9e6", (band("z", 0.30 * length, 0.36 * length), colour))
    cap = frustum(0.96 * diameter, 0.80 * diameter, 0.32 * length, 10).painted(plain(colour))
    return cylinder(diameter, 0.68 * length, 10).painted(barrel), cap.moved(z=0.68 * length)


def _toys() -> Iterator[HouseholdItem]:
    yield "soccer_ball", "ball", 123, _ball(0.140, "f4f4f0", (dots(12, 0.93), "1d1f24"))
    yield "softball", "ball", 191, _ball(0.096, "d7e33f", (seam(0.05), "b3261e"))
    yield "baseball", "ball", 138, _ball(0.075, "f3efe6", (seam(0.06), "b3261e"))
    yield "tennis_ball", "ball", 58, _ball(0.0647, "c6df3a", (seam(0.08), "f4f4f0"))
    yield "racquetball", "ball", 41, _ball(0.0553, "2456b8")
    yield "golf_ball", "ball", 46, _ball(0.0427, "f6f6f3", (dots(150, 0.994), "d5d6d4"))

    # The grain of a plank along z.
    grain = [(band("x", at, at + 0.004), "a87441") for at in (-0.034, -0.019, -0.003, 0.013, 0.029)]
    rings = (spot("z", 0.01, 0.005, 0.03), "a87441"), (spot("z", 0.01, 0.005, 0.024), "c89058")
    wood = layers("c89058", *grain, *rings)
    yield "wood_block", "block", 729, (box(0.085, 0.085, 0.200).painted(wood),)
    yield "foam_brick", "block", 28, (box(0.050, 0.075, 0.050).painted(plain("b5432e")),)
    yield "cube_puzzle", "block", 94, (box(0.057, 0.057, 0.057, 6).painted(_squares(0.057)),)
    yield "long_brick", "block", 37.2, _brick((4, 2), 0.0192, "2f7d32")
    yield "square_brick", "block", 18.6, _brick((2, 2), 0.0384, "f9c80e")
    rough = layers("f2cf3b", (band("z", 0.002, 1.0), "3f8f4f"))
    yield "sponge", "block", 6.2, (box(0.072, 0.114, 0.014).painted(rough),)

    hand = panel("z", (-0.002, 0.002), (0.0, 0.020)), "d9362b"
    dial = layers(CREAM, hand, (spot("z", 0.0, 0.0, 0.006), "d9362b"))
    timer = (
        box(0.085, 0.080, 0.028, 1).painted(plain("2f6f73")).moved(z=0.014),
        frustum(0.056, 0.046, 0.012).painted(dial).moved(z=0.028),
    )
    yield "timer", "appliance", 102, timer


def _ball(diameter: float, ground: str, *marks: tuple[Mark, str]) -> Solids:
    return (ellipsoid(diameter, diameter, diameter).painted(layers(ground, *marks)),)


def _squares(side: float) -> Paint:
    """Return paint of 3 x 3 coloured squares on each side of a cube, turned out of order."""
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


def _brick(studs: tuple[int, int], height: float, colour: str, pitch: float = 0.0159) -> Solids:
    """Return a toy brick with studs along x and y that stand 4.5 mm proud."""
    across, along = studs
    body = box(across * pitch, along * pitch, height, 1)
    stud = cylinder(0.0095, 0.0045, 8, 1)
    places = [
        ((i - (across - 1) / 2) * pitch, (j - (along - 1) / 2) * pitch)
        for i in range(across)
        for j in range(along)
    ]
    return _painted([body, *(stud.moved(x, y, height / 2) for x, y in places)], plain(colour))


def _painted(solids: Solids, paint: Paint) -> Sequence[Solid]:
    return [solid.painted(paint) for solid in solids]
