"""Figures as SVG text, the same bytes from the same numbers."""

import base64
import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib.style
from matplotlib.axes import Axes
from matplotlib.figure import Figure

# Okabe and Ito's colours, told apart by colour-blind readers; yellow is left out on white paper.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
GREY = "#8a8f98"
PRINTED_WIDTH = 7.4
"""Of a figure that fills an A4 page between its margins [inch]."""

_POLICIES = {
    "method": (COLOURS[0], "o"),
    "plus": (COLOURS[3], "D"),
    "ddpg": (COLOURS[1], "v"),
    "no-teachers": (COLOURS[2], "s"),
    "no-asymmetry": (COLOURS[4], "^"),
    "no-pose-input": (COLOURS[5], "P"),
    "teacher-straight": ("#3f444d", ">"),
    "teacher-zigzag": ("#6b717c", "h"),
    "teacher-spiral": ("#3f444d", "<"),
    "look-ahead": (COLOURS[6], "*"),
    "random": (GREY, "x"),
    "idle": (GREY, "+"),
}
_STYLE: dict[str, Any] = {
    "svg.hashsalt": "mechsearch",
    "font.size": 9.5,
    "font.family": "DejaVu Sans",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#5b616b",
    "axes.labelcolor": "#20242c",
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "xtick.color": "#5b616b",
    "ytick.color": "#5b616b",
    "legend.frameon": False,
    "lines.linewidth": 1.8,
}


def colour(policy: str) -> str:
    """Return the colour of a policy, the same in all figures."""
    return _POLICIES.get(policy, (COLOURS[6], "."))[0]


def marker(policy: str) -> str:
    """Return the mark of a policy, the same in all figures."""
    return _POLICIES.get(policy, (COLOURS[6], "."))[1]


@contextmanager
def style() -> Iterator[None]:
    """Draw in the project's style within the block."""
    with matplotlib.style.context(_STYLE):
        yield


def grid(panels: int, columns: int, width: float, height: float) -> tuple[Figure, list[Axes]]:
    """Return a figure with `panels` axes in rows of `columns`, each `width` x `height` [inch]."""
    rows = -(-panels // columns)
    figure = Figure(figsize=(width * columns, height * rows), layout="constrained")
    axes = [figure.add_subplot(rows, columns, i + 1) for i in range(panels)]
    return figure, axes


def to_svg(figure: Figure) -> str:
    """Return a figure as SVG text without a date."""
    buffer = io.StringIO()
    with style():
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def data_uri(content: bytes | str, kind: str) -> str:
    """Return content as a `data:` address, such as of kind "image/svg+xml"."""
    raw = content.encode() if isinstance(content, str) else content
    return f"data:{kind};base64,{base64.b64encode(raw).decode()}"
