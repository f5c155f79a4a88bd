"""Draws the concepts: `python docs/drawings.py` writes `docs/images/concept-*.svg`."""

import io
import re
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch, Polygon, Rectangle

IMAGES = Path(__file__).parent / "images"
INK, SOFT, LINE, PAPER = "#20242c", "#5b616b", "#9aa0a8", "#f5f6f7"
TARGET, PATH, OTHER = "#009E73", "#1c62eb", "#c9c2b6"
GREENS = LinearSegmentedColormap.from_list("greens", ["#ffffff", TARGET])


class Drawing:
    """A sheet on which one draws, `wide` x `high` in units of about two letters."""

    def __init__(self, wide, high):
        self.figure = Figure(figsize=(wide * 0.4, high * 0.4))
        self.axes = self.figure.add_axes((0, 0, 1, 1))
        self.axes.set(xlim=(0, wide), ylim=(0, high))
        self.axes.set_axis_off()

    def text(self, x, y, words, size=10, colour=INK, at="center", **style):
        """Write words about a point."""
        self.axes.text(x, y, words, size=size, color=colour, ha=at, va="center", **style)

    def box(self, x, y, wide, high, words, colour=PAPER, edge=LINE, size=9.5):
        """Draw a box by its lower left corner, with words in it."""
        shape = FancyBboxPatch(
            (x, y), wide, high, boxstyle="round,pad=0,rounding_size=0.2", fc=colour, ec=edge, lw=1.2
        )
        self.axes.add_patch(shape)
        self.text(x + wide / 2, y + high / 2, words, size)

    def arrow(self, start, end, words="", colour=SOFT, bend=0.0, above=0.3):
        """Draw an arrow from a point to another, with words beside its middle."""
        shape = {"arrowstyle": "-|>", "color": colour, "lw": 1.4, "shrinkA": 0, "shrinkB": 0}
        shape["connectionstyle"] = f"arc3,rad={bend}"
        self.axes.annotate("", end, start, arrowprops=shape)
        middle = np.mean([start, end], axis=0)
        self.text(middle[0], middle[1] + above, words, 8.5, SOFT)

    def line(self, points, colour=PATH, width=2.2, **style):
        """Draw a line through points (N, 2)."""
        self.axes.plot(*np.transpose(points), color=colour, lw=width, **style)

    def shape(self, points, colour, edge=INK):
        """Draw a polygon."""
        self.axes.add_patch(Polygon(points, fc=colour, ec=edge, lw=1.1))

    def pixels(self, x, y, side, values, map="gray"):
        """Draw pixels (H, W) from 0 to 1 as squares, from the lower left corner of the lowest."""
        high, wide = np.shape(values)
        extent = (x, x + side * wide, y, y + side * high)
        self.axes.imshow(
            values, map, vmin=0, vmax=1, extent=extent, origin="lower", aspect="auto",
            interpolation="none", zorder=0,
        )  # fmt: skip
        for k in range(wide + 1):
            self.line([(x + side * k, y), (x + side * k, y + side * high)], "#d9dce1", 0.8)
        for k in range(high + 1):
            self.line([(x, y + side * k), (x + side * wide, y + side * k)], "#d9dce1", 0.8)

    def square(self, x, y, side, colour, edge=INK):
        """Draw a square by its lower left corner."""
        self.axes.add_patch(Rectangle((x, y), side, side, fc=colour, ec=edge, lw=1.1))

    def write(self, name):
        """Write it, the same bytes each time, with text as text."""
        style = {"svg.fonttype": "none", "svg.hashsalt": name, "font.family": "DejaVu Sans"}
        buffer = io.StringIO()
        with matplotlib.rc_context(style):
            self.figure.savefig(buffer, format="svg", metadata={"Date": None})
        family = "font-family: 'DejaVu Sans', Verdana, sans-serif;"
        text = re.sub("font-family: [^;]*;", family, buffer.getvalue())
        # Without Matplotlib's ids, comments and spaces at ends of lines.
        text = re.sub(r"<!--.*?-->\n?| +$", "", text, flags=re.MULTILINE)
        (IMAGES / f"concept-{name}.svg").write_text(text)


def heap(d, x, y):
    """Draw a heap from the side, its target under a box; 5 wide, 2.2 high."""
    d.line([(x - 1.2, y), (x + 6.2, y)], LINE, 2)
    d.shape([(x, y), (x + 1.1, y), (x + 1.1, y + 1.2), (x, y + 1.2)], OTHER)
    d.shape([(x + 1.2, y), (x + 3.4, y), (x + 3.4, y + 0.7), (x + 1.2, y + 0.7)], TARGET)
    d.shape([(x + 3.6, y), (x + 5, y), (x + 4.6, y + 1.3), (x + 3.9, y + 1.3)], OTHER)
    d.shape([(x + 0.6, y + 1.25), (x + 3.2, y + 0.75), (x + 3.4, y + 1.5), (x + 0.8, y + 2)], OTHER)


def task():
    """An action of the task."""
    d = Drawing(24, 9)
    d.line([(6.5, 7.4), (2.2, 1)], LINE, 1, ls="--")
    d.line([(6.5, 7.4), (10.8, 1)], LINE, 1, ls="--")
    d.box(5.4, 7.2, 2.2, 0.9, "camera")
    heap(d, 4, 1)
    d.text(5.4, 0.4, "target, partly hidden", 8.5, TARGET)
    d.shape([(2.6, 1.9), (2.95, 1.9), (2.95, 4.6), (2.6, 4.6)], "#3f444d")
    d.arrow((2.95, 2.4), (4.5, 2.4), "", PATH)
    d.text(2.7, 5.0, "end effector", 8.5)
    d.text(1.3, 2.4, "at most\n5 cm", 8.5, PATH)
    d.box(13.2, 5.9, 4.4, 1.5, "depth image and\nposition image")
    d.box(19.2, 5.9, 3.6, 1.5, "policy")
    d.box(19.2, 2.4, 3.6, 1.5, "displacement\n(3 numbers)")
    d.box(13.2, 2.4, 4.4, 1.5, "physics, then the\nreward's five terms")
    d.arrow((7.9, 7.6), (13.1, 6.9), "renders")
    d.arrow((17.6, 6.65), (19.1, 6.65))
    d.arrow((21, 5.9), (21, 4))
    d.arrow((19.2, 3.15), (17.7, 3.15))
    d.arrow((15.4, 4), (15.4, 5.8), "")
    d.text(
        17.9, 1.1, "until the target is uncovered (at most 2 % hidden), or 50 actions", 8.5, SOFT
    )
    d.write("task")


def position_image():
    """The mid-level image."""
    d = Drawing(24, 8)
    rng = np.random.default_rng(4)
    lift = rng.uniform(0.35, 0.9, (6, 6))
    mask = np.zeros((6, 6), bool)
    mask[2:4, 1:4] = mask[4, 2] = True
    for x, title in ((1, "depth"), (9, "the target's visible pixels"), (17, "position image")):
        d.text(x + 3, 7.2, title, 10, weight="bold")
        values = lift if x == 1 else mask * (0.85 if x == 9 else 0.2)
        d.pixels(x, 0.6, 1, values, "gray" if x == 1 else GREENS)
    tip = (22.4, 1.2)
    for row, column in np.argwhere(mask):
        d.arrow(tip, (17.5 + column, 1.1 + row), "", PATH)
    d.axes.plot(*tip, "o", color="#3f444d", ms=8)
    d.arrow((7.2, 3.6), (8.8, 3.6))
    d.arrow((15.2, 3.6), (16.8, 3.6))
    d.text(20, 0.15, "x, y, z from the tip [m], elsewhere 0", 8.5, SOFT)
    d.text(4, 0.15, "the camera's, from above", 8.5, SOFT)
    d.text(11.8, 0.15, "given, or found by a segmentation", 8.5, SOFT)
    d.write("position-image")


def teachers():
    """Who suggests, and who chooses."""
    d = Drawing(24, 9.4)
    turns = np.linspace(0, 5.2 * np.pi, 90)
    zigzag = [(k * 0.45, 0.45 * (-1) ** k * (0 < k < 6)) for k in range(7)]
    shapes = {
        "straight": [(0, 0), (2.7, 0)],
        "zigzag": zigzag,
        "spiral": np.stack(
            [1.4 + turns * 0.045 * np.cos(turns), turns * 0.045 * np.sin(turns)], axis=1
        ),
    }
    for i, (name, points) in enumerate(shapes.items()):
        y = 6.4 - 1.9 * i
        d.box(0.6, y - 0.8, 6.2, 1.6, "")
        d.text(1.0, y, name, 9.5, at="left")
        d.line(np.add(points, (3.7, y)), PATH, 1.8)
        d.arrow((6.9, y), (9.4, 4.9 + 0.35 * (1 - i)))
    d.text(3.7, 8.3, "teachers, who know where objects are", 9, weight="bold")
    d.box(0.6, 0.2, 6.2, 1.4, "actor, who sees images alone", "#e8effd")
    d.arrow((6.9, 1), (9.4, 4))
    d.text(8.6, 7.0, "suggest", 8.5, SOFT)
    d.box(9.5, 3.5, 4.6, 2.6, "critic\nexpects of each what\nis to come; knows\nall positions")
    d.arrow((14.1, 4.8), (16.6, 4.8), "the best")
    d.box(16.7, 4.1, 3.2, 1.4, "executed")
    d.arrow((18.3, 4.1), (18.3, 2.3))
    d.box(16.2, 0.8, 4.2, 1.4, "replay")
    d.arrow((16.2, 1.5), (6.9, 0.7), "the critic's gradient, and what the spiral did", above=-0.75)
    d.arrow((16.2, 2), (12.2, 3.4), "outcomes", above=-0.4)
    d.text(22, 4.8, "in training;\nlater the actor\nacts alone", 8.5, SOFT)
    d.write("teachers")


def push_values():
    """How `plus` chooses a push."""
    d = Drawing(24, 8.6)
    centre, rng = np.array([3.2, 4.2]), np.random.default_rng(1)
    for place, side in (((1.6, 4.4), 1.3), ((3.6, 3.1), 1.5), ((2.9, 5.1), 1.2)):
        d.square(*place, side, OTHER)
    d.square(*(centre - 0.4), 0.9, TARGET)
    for angle in rng.uniform(0, 2 * np.pi, 9):
        way = np.array([np.cos(angle), np.sin(angle)])
        d.arrow(centre - 2.6 * way, centre - 0.7 * way, "", LINE)
    d.arrow((0.6, 4.2), (2.5, 4.2), "", PATH)
    d.text(3.2, 0.9, "96 pushes at random\nabout the visible target", 8.5, SOFT)
    d.text(3.2, 7.8, "a heap from above", 9.5, weight="bold")
    d.arrow((6.2, 4.2), (8, 4.2), "for each")
    for k in range(3):
        d.square(8.2 + 0.25 * k, 2.8 + 0.25 * k, 2.6, "#ffffff", LINE)
    d.square(9.7, 4.1, 0.8, TARGET)
    d.arrow((8.9, 4.5), (11.1, 4.5), "", PATH)
    d.text(9.8, 7.8, "how it looks", 9.5, weight="bold")
    d.text(9.8, 0.9, "32 x 32 pixels of heights,\nturned so that it goes forward", 8.5, SOFT)
    d.arrow((11.6, 4.2), (13.2, 4.2))
    d.box(13.3, 2.6, 4.1, 3.2, "three networks:\nreward, uncovered?,\nocclusion, actions")
    d.arrow((17.4, 4.2), (18.9, 4.2), "value")
    d.box(19, 3.5, 4.4, 1.4, "the best is executed", "#e8effd")
    d.text(
        21.2,
        1.6,
        "in training 23 others are tried\nin the simulator, from the\nsame state, and learnt from",
        8.5,
        SOFT,
    )
    d.text(15.4, 7.8, "what it will bring", 9.5, weight="bold")
    d.write("push-values")


def retrieval():
    """The decisions of retrieval."""
    d = Drawing(24, 8.6)
    d.box(0.5, 3.6, 3.8, 1.5, "look: depth,\nobjects, target")
    rows = {
        6.2: ("push", "moves what lies over the target"),
        3.65: ("grasp the target", "descend, close, lift, shake"),
        1.1: ("remove another object", "into the tray"),
    }
    for y, (name, words) in rows.items():
        d.box(7.4, y, 5.4, 1.4, name)
        d.text(10.1, y - 0.35, words, 8.5, SOFT)
        d.arrow((4.3, 4.35), (7.3, y + 0.7))
        d.arrow((12.8, y + 0.7), (15.4, 4.5))
    d.text(5.5, 6.9, "candidates,\nrated", 8.5, SOFT)
    d.box(15.5, 3.4, 4.2, 2, "value: chance of the\nnext grasp, less what\nit costs", "#e8effd")
    d.arrow((19.7, 4.4), (21.2, 4.4))
    d.box(21.3, 3.7, 2.3, 1.4, "do it")
    d.line([(22.4, 3.7), (22.4, 0.3), (2.4, 0.3), (2.4, 3.5)], SOFT, 1.4)
    d.arrow((2.4, 3.1), (2.4, 3.55))
    d.text(17.4, 0.7, "until it is in the hand, or nothing is left to try", 8.5, SOFT)
    d.arrow((22.4, 5.1), (22.4, 7))
    d.text(22.2, 7.5, "retrieved", 9.5, TARGET, weight="bold")
    d.write("retrieval")


def statistics():
    """How an interval is made."""
    d = Drawing(24, 8.6)
    rng, seeds, heaps = np.random.default_rng(3), 4, 9
    values = np.clip(rng.normal(0.6, 0.13, (seeds, 1)) + rng.normal(0, 0.16, (1, heaps)), 0.1, 0.95)
    d.pixels(1.9, 3, 0.75, values)
    d.text(5.3, 7.8, "a score of each seed on each heap", 9.5, weight="bold")
    d.text(5.3, 6.5, "heaps", 8.5, SOFT)
    d.text(1.2, 4.5, "seeds", 8.5, SOFT, rotation=90)
    d.text(
        5.3,
        1.7,
        "rows and columns are drawn anew,\neach by itself; two policies share\nthe draw of heaps",
        8.5,
        SOFT,
    )
    d.arrow((9, 4.5), (11.2, 4.5), "many times")
    heights = np.exp(-(np.linspace(-2.3, 2.3, 15) ** 2) / 2)
    for k, height in enumerate(heights):
        corner = (11.8 + 0.28 * k, 3)
        d.axes.add_patch(Rectangle(corner, 0.24, 2.6 * height, fc="#8fb4f5", ec="none"))
    d.text(13.9, 7.8, "means of the draws", 9.5, weight="bold")
    d.arrow((16.4, 4.5), (17.4, 4.5))
    d.text(20.6, 7.8, "95 % interval of a difference", 9.5, weight="bold")
    d.line([(20, 2.2), (20, 6.8)], INK, 1.2, ls="--")
    d.text(20, 1.8, "threshold", 8.5, SOFT)
    verdicts = (
        (6.2, 20.6, 22.2, "holds"),
        (4.6, 19.3, 20.9, "undecided"),
        (3, 17.9, 19.5, "does not hold"),
    )
    for y, low, high, words in verdicts:
        d.line([(low, y), (high, y)], PATH, 3)
        d.axes.plot((low + high) / 2, y, "o", color=PATH, ms=6)
        d.text((low + high) / 2, y + 0.5, words, 8.5)
    d.write("statistics")


if __name__ == "__main__":
    for draw in (task, position_image, teachers, push_values, retrieval, statistics):
        draw()
