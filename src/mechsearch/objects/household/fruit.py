"""Fruit."""

from mechsearch.objects.household.paint import band, blend, dots, layers, plain
from mechsearch.objects.household.primitives import (
    Item,
    Paint,
    Solids,
    cylinder,
    ellipsoid,
    fitted,
    frustum,
    stack,
    tube,
)

STALK = "5b3d1e"


def round_fruit(x: float, y: float, z: float, paint: Paint, stalk: float = 0.0) -> Solids:
    """Return an ellipsoid with diameters x, y, z [m] and, if long, a stalk [m]."""
    body = ellipsoid(x, y, z).painted(paint)
    if not stalk:
        return (body,)
    stem = cylinder(0.004, stalk + 0.004, 6, 1).painted(plain(STALK))
    return (body, stem.moved(z=z / 2 - 0.004))


def apple() -> Solids:
    """Return an apple of 75 mm with a stalk."""
    return round_fruit(0.075, 0.075, 0.069, blend("c2182b", "d9a52e", "z", 0.0, 0.045), 0.012)


def orange() -> Solids:
    """Return an orange of 73 mm."""
    pores = layers("ee8a1d", (dots(200, 0.9995), "d97812"), (band("z", 0.0352, 1.0), "3c6b2a"))
    return round_fruit(0.073, 0.073, 0.071, pores)


def peach() -> Solids:
    """Return a peach of 59 mm."""
    return round_fruit(0.059, 0.059, 0.057, blend("f4b35a", "d9503f", "x", -0.02, 0.025))


def plum() -> Solids:
    """Return a plum of 52 mm."""
    return round_fruit(0.052, 0.052, 0.050, blend("4a1838", "7d2a55", "z", -0.02, 0.02), 0.006)


def lemon() -> Solids:
    """Return a lemon of 68 x 54 mm with its two tips."""
    yellow = plain("f2d024")
    tip = frustum(0.020, 0.007, 0.010, 8, 2).painted(plain("e0b81c")).moved(z=0.0265)
    return (
        ellipsoid(0.062, 0.054, 0.054).painted(yellow),
        tip.turned("y", 90).moved(-0.0025),
        tip.turned("y", -90).moved(0.0025),
    )


def pear() -> Solids:
    """Return a pear of 100 x 66 mm in seven slices, with a stalk."""
    profile = [(0.022, -0.031), (0.046, -0.024), (0.0625, -0.012), (0.0662, 0.0), (0.060, 0.014)]
    profile += [(0.041, 0.036), (0.034, 0.050), (0.014, 0.060)]
    skin = blend("7fa33a", "c9c04a", "z", -0.02, 0.05)
    flesh = [piece.painted(skin) for piece in stack(profile)]
    return (*flesh, cylinder(0.004, 0.009, 6, 1).moved(z=0.060).painted(plain(STALK)))


def strawberry() -> Solids:
    """Return a strawberry of 55 x 44 mm in six slices, with its leaves."""
    profile = [(0.010, -0.029), (0.022, -0.022), (0.037, -0.008), (0.0438, 0.005)]
    profile += [(0.041, 0.013), (0.031, 0.019), (0.014, 0.022)]
    seeds = layers("d3212c", (dots(60, 0.994), "f0c85a"))
    leaves = frustum(0.036, 0.018, 0.006, 8, 1).painted(plain("3f8f2f")).moved(z=0.020)
    return (*(piece.painted(seeds) for piece in stack(profile)), leaves)


def banana() -> Solids:
    """Return a banana, 190 mm long and 36 mm thick, in five pieces."""
    path = [
        (-0.095, 0.034),
        (-0.074, 0.018),
        (-0.032, 0.0),
        (0.020, 0.0),
        (0.066, 0.016),
        (0.088, 0.036),
    ]
    widths = [0.010, 0.026, 0.036, 0.037, 0.030, 0.012]
    skin = layers("efcf2f", (band("x", -1, -0.088), STALK), (band("x", 0.082, 1), "3a2a16"))
    pieces = [piece.painted(skin) for piece in tube(path, widths, widths)]
    return fitted(pieces, 0.190, 0.060, 0.036)


FRUIT = (
    Item("banana", "fruit", 66, banana),
    Item("strawberry", "fruit", 18, strawberry),
    Item("apple", "fruit", 68, apple),
    Item("lemon", "fruit", 29, lemon),
    Item("peach", "fruit", 33, peach),
    Item("pear", "fruit", 49, pear),
    Item("orange", "fruit", 47, orange),
    Item("plum", "fruit", 25, plum),
)
