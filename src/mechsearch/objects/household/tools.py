"""Household tools: cutlery, scissors, screwdrivers, a wrench, a drill, a padlock, clamps, pens."""

from collections.abc import Sequence
from functools import partial

from mechsearch.objects.household.paint import band, layers, panel, plain, window
from mechsearch.objects.household.primitives import (
    Item,
    Solid,
    Solids,
    box,
    cylinder,
    fitted,
    frustum,
    prism,
    shell,
    tube,
)

STEEL = "a9adb3"
DARK = "2b2d31"
BRASS = "c9a24a"


def _handle(colour: str) -> Solids:
    """Return the handle of cutlery along x, from -0.100 to 0.024 m, two pieces arched upwards."""
    grip = tube(
        [(-0.100, 0.004), (-0.050, 0.007), (0.024, 0.003)],
        [0.007, 0.008, 0.005],
        [0.015, 0.014, 0.007],
    )
    return [piece.turned("x", 90).painted(plain(colour)) for piece in grip]


def _upright(outline: Sequence[tuple[float, float]], low: float, thick: float) -> Solid:
    return prism(outline, thick).moved(z=low).painted(plain(STEEL))


def fork() -> Solids:
    """Return a fork of 198 mm with three prongs."""
    palm = [(0.010, -0.003), (0.040, -0.010), (0.052, -0.010)]
    blade = _upright([*palm, *((x, -y) for x, y in palm[::-1])], 0.001, 0.004)
    prongs = [box(0.050, 0.004, 0.003, 1).moved(0.073, y, 0.003) for y in (-0.008, 0.0, 0.008)]
    head = [blade, *(prong.painted(plain(STEEL)) for prong in prongs)]
    return fitted([*_handle("3a6ea5"), *head], 0.198, 0.024, 0.014)


def knife() -> Solids:
    """Return a table knife of 215 mm."""
    edge = [(0.008, -0.006), (0.095, -0.010), (0.112, -0.004), (0.115, 0.008), (0.008, 0.006)]
    return fitted([*_handle("3a6ea5"), _upright(edge, 0.001, 0.003)], 0.215, 0.020, 0.014)


def spoon() -> Solids:
    """Return a spoon of 195 mm with a hollow bowl of six pieces."""
    steel = plain(STEEL)
    wall = shell(
        [(0.006, 0.002), (0.0185, 0.0105)], [(0.020, 0.0105), (0.015, 0.003), (0.007, 0.0)], 6
    )
    hollow = [*wall, cylinder(0.014, 0.0025, 6, 1)]
    head = [piece.scaled(x=1.75).moved(0.060, z=-0.006).painted(steel) for piece in hollow]
    return fitted([*_handle("3a6ea5"), *head], 0.195, 0.040, 0.020)


def scissors() -> Solids:
    """Return open scissors of 200 x 87 mm: two blades and two loops."""
    loop = [(-0.016, -0.006), (-0.060, -0.005), (-0.095, -0.018), (-0.088, -0.040)]
    loop += [(-0.048, -0.034), (-0.020, -0.009)]
    rings = [piece.painted(plain("d9541e")) for piece in tube(loop, [0.009] * 6, [0.009] * 6)]
    blade = prism([(-0.022, -0.009), (0.030, -0.004), (0.102, 0.010), (0.030, 0.012)], 0.0035)
    lower = [blade.painted(plain(STEEL)).moved(z=-0.0035), *rings]
    pivot = cylinder(0.010, 0.010, 8, 1).moved(0.0, 0.0, -0.005).painted(plain(DARK))
    return fitted(
        [*lower, *(piece.turned("x", 180) for piece in lower), pivot], 0.200, 0.087, 0.014
    )


def screwdriver(colour: str, flat: bool) -> Solids:
    """Return a screwdriver of 215 mm with a cross or a flat tip."""
    grip = layers(colour, *((window(30 * k, 8, 0.012, 0.080, 1), DARK) for k in range(12)))
    steel = plain(STEEL)
    tip = (
        box(0.008, 0.002, 0.012, 1) if flat else frustum(0.006, 0.002, 0.012, 6, 1).moved(z=-0.006)
    )
    return (
        frustum(0.026, 0.031, 0.060, 12).painted(grip),
        frustum(0.031, 0.022, 0.032, 12).painted(plain(colour)).moved(z=0.060),
        cylinder(0.0065, 0.113, 8, 1).painted(steel).moved(z=0.090),
        tip.painted(steel).moved(z=0.209),
    )


def wrench() -> Solids:
    """Return an adjustable wrench of 205 x 55 mm."""
    steel = plain(STEEL)
    bar = [(-0.100, -0.010), (-0.090, -0.013), (0.050, -0.009), (0.050, 0.009), (-0.090, 0.013)]
    head = [(0.042, -0.018), (0.056, -0.030), (0.072, -0.028), (0.074, 0.018), (0.050, 0.020)]
    fixed = [(0.068, -0.029), (0.100, -0.016), (0.105, -0.006), (0.072, -0.006)]
    sliding = [(0.068, 0.009), (0.098, 0.009), (0.092, 0.020), (0.070, 0.025)]
    return (
        prism([*bar, (-0.100, 0.010)], 0.009).moved(z=-0.0045).painted(steel),
        prism(head, 0.014).moved(z=-0.007).painted(steel),
        prism(fixed, 0.012).moved(z=-0.006).painted(plain("90949a")),
        prism(sliding, 0.012).moved(z=-0.006).painted(plain("90949a")),
        cylinder(0.012, 0.016, 8, 1).moved(0.058, 0.010, -0.008).painted(plain(DARK)),
    )


def drill() -> Solids:
    """Return a cordless drill of 184 x 50 x 160 mm."""
    body = layers("d8472b", (band("z", 0.0, 0.016), DARK), (band("z", 0.098, 0.118), DARK))
    dark = plain(DARK)
    grip = [(-0.030, 0.026), (0.006, 0.026), (0.000, 0.140), (-0.044, 0.140)]
    solids = (
        cylinder(0.057, 0.118).painted(body).turned("y", 90).moved(-0.072, 0, 0.1555),
        frustum(0.042, 0.022, 0.070, 12).painted(dark).turned("y", 90).moved(0.045, 0, 0.1555),
        prism(grip, 0.036).moved(z=-0.018).turned("x", 90).painted(dark),
        box(0.082, 0.056, 0.030, 2).moved(0.0, 0.0, 0.015).painted(plain("d8472b")),
    )
    return fitted(solids, 0.184, 0.050, 0.160)


def padlock() -> Solids:
    """Return a closed padlock of 65 x 47 x 24 mm."""
    face = layers(BRASS, (panel("z", (-0.012, 0.012), (-0.026, -0.012)), DARK))
    shackle = tube(
        [
            (-0.016, 0.004),
            (-0.016, 0.016),
            (-0.009, 0.027),
            (0.009, 0.027),
            (0.016, 0.016),
            (0.016, 0.004),
        ],
        [0.008] * 6,
        [0.008] * 6,
    )
    body = box(0.047, 0.038, 0.024).moved(y=-0.014).painted(face)
    bright = [piece.painted(plain("c9ccd1")) for piece in shackle]
    return fitted([body, *bright], 0.047, 0.065, 0.024)


def clamp(length: float, width: float, thick: float) -> Solids:
    """Return a spring clamp: two arms that part at the handles and meet at the jaws."""
    arm = 0.085 * length
    path = [
        (-0.5 * length, 0.5 * width - 0.5 * arm),
        (0.02 * length, 0.62 * arm),
        (0.28 * length, 0.24 * width),
        (0.48 * length, 0.52 * arm),
    ]
    side = tube(path, [arm, 1.2 * arm, arm, 0.9 * arm], [thick, thick, thick, 0.8 * thick])
    grip = layers(DARK, (band("x", -length, -0.30 * length), "e8641b"))
    upper = [piece.painted(grip) for piece in side]
    pivot = cylinder(2.2 * arm, 0.9 * thick, 10, 1).moved(0.02 * length, 0, -0.45 * thick)
    lower = [piece.turned("x", 180) for piece in upper]
    return fitted([*upper, *lower, pivot.painted(plain(STEEL))], length, width, thick)


def felt_pen(diameter: float, length: float, colour: str) -> Solids:
    """Return a felt pen with its cap on."""
    barrel = layers("e9e9e6", (band("z", 0.30 * length, 0.36 * length), colour))
    return (
        cylinder(diameter, 0.68 * length, 10).painted(barrel),
        frustum(0.96 * diameter, 0.80 * diameter, 0.32 * length, 10)
        .painted(plain(colour))
        .moved(z=0.68 * length),
    )


TOOLS = (
    Item("fork", "cutlery", 34, fork),
    Item("spoon", "cutlery", 30, spoon),
    Item("knife", "cutlery", 31, knife),
    Item("power_drill", "tool", 895, drill),
    Item("scissors", "tool", 82, scissors),
    Item("cross_screwdriver", "tool", 97, partial(screwdriver, "d9a520", flat=False)),
    Item("flat_screwdriver", "tool", 98.4, partial(screwdriver, "2e6fb7", flat=True)),
    Item("wrench", "tool", 252, wrench),
    Item("padlock", "tool", 208, padlock),
    Item("large_marker", "tool", 15.8, partial(felt_pen, 0.018, 0.121, "1b1b1e")),
    Item("small_marker", "tool", 8.2, partial(felt_pen, 0.010, 0.135, "b3261e")),
    Item("small_clamp", "clamp", 19.2, partial(clamp, 0.085, 0.065, 0.010)),
    Item("medium_clamp", "clamp", 59, partial(clamp, 0.115, 0.090, 0.027)),
    Item("large_clamp", "clamp", 125, partial(clamp, 0.165, 0.125, 0.032)),
    Item("extra_large_clamp", "clamp", 202, partial(clamp, 0.213, 0.165, 0.037)),
)
