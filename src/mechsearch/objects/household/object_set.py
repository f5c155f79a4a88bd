"""The embedded object set: everyday things modelled in code, ready without a download.

Categories, dimensions and masses follow the table of the YCB set (Calli et al., "Benchmarking in
Manipulation Research", IEEE Robotics & Automation Magazine, 2015); shapes and colours are our own.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial

from mechsearch.objects.household.assembly import assemble
from mechsearch.objects.household.containers import (
    Solids,
    bleach_bottle,
    bowl,
    can,
    carton,
    cup,
    loaf_can,
    mug,
    mustard_bottle,
    pitcher_lid,
    wine_glass,
)
from mechsearch.objects.household.fruit import (
    apple,
    banana,
    lemon,
    orange,
    peach,
    pear,
    plum,
    strawberry,
)
from mechsearch.objects.household.paint import plain
from mechsearch.objects.household.tools import (
    clamp,
    drill,
    fork,
    knife,
    marker,
    padlock,
    scissors,
    screwdriver,
    spoon,
    wrench,
)
from mechsearch.objects.household.toys import (
    ball,
    block,
    brick,
    cube_puzzle,
    dotted,
    sponge,
    stitched,
    timer,
    wood,
)
from mechsearch.objects.model import ObjectSet


@dataclass(frozen=True)
class Item:
    """One entry of the set.

    Attributes:
        name: Unique.
        category: Such as "can".
        grams: Mass [g].
        shape: Makes its convex solids.
    """

    name: str
    category: str
    grams: float
    shape: Callable[[], Solids]


ITEMS = (
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
    Item("banana", "fruit", 66, banana),
    Item("strawberry", "fruit", 18, strawberry),
    Item("apple", "fruit", 68, apple),
    Item("lemon", "fruit", 29, lemon),
    Item("peach", "fruit", 33, peach),
    Item("pear", "fruit", 49, pear),
    Item("orange", "fruit", 47, orange),
    Item("plum", "fruit", 25, plum),
    Item("fork", "cutlery", 34, fork),
    Item("spoon", "cutlery", 30, spoon),
    Item("knife", "cutlery", 31, knife),
    Item("power_drill", "tool", 895, drill),
    Item("scissors", "tool", 82, scissors),
    Item("cross_screwdriver", "tool", 97, partial(screwdriver, "d9a520", flat=False)),
    Item("flat_screwdriver", "tool", 98.4, partial(screwdriver, "2e6fb7", flat=True)),
    Item("wrench", "tool", 252, wrench),
    Item("padlock", "tool", 208, padlock),
    Item("large_marker", "tool", 15.8, partial(marker, 0.018, 0.121, "1b1b1e")),
    Item("small_marker", "tool", 8.2, partial(marker, 0.010, 0.135, "b3261e")),
    Item("small_clamp", "clamp", 19.2, partial(clamp, 0.085, 0.065, 0.010)),
    Item("medium_clamp", "clamp", 59, partial(clamp, 0.115, 0.090, 0.027)),
    Item("large_clamp", "clamp", 125, partial(clamp, 0.165, 0.125, 0.032)),
    Item("extra_large_clamp", "clamp", 202, partial(clamp, 0.213, 0.165, 0.037)),
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


@cache
def household() -> ObjectSet:
    """Return the default set: 56 objects of the household, none left out of heaps."""
    models = {
        item.name: assemble(item.name, item.category, item.grams / 1000, item.shape())
        for item in ITEMS
    }
    return ObjectSet("household", models, {})
