"""Reliability diagrams: predicted chances of success against what happened."""

from collections.abc import Mapping

from mechsearch.report.figures import COLOURS, GREY, grid, style, to_svg
from mechsearch.types import Floats


def draw_reliability(curves: Mapping[str, Floats]) -> str:
    """Return an SVG of reliability curves, with how often each chance was predicted below.

    Args:
        curves: By name: mean prediction, share of successes and number (b, 3) of each bin.
    """
    with style():
        figure, (ax, below) = grid(2, 1, 4.6, 2.9)
        ax.plot([0, 1], [0, 1], color=GREY, linewidth=1, linestyle="--", zorder=0)
        for i, ((name, curve), colour) in enumerate(zip(curves.items(), COLOURS, strict=False)):
            predicted, share, number = curve.T
            ax.plot(predicted, share, "o-", color=colour, label=name, markersize=4)
            width = 0.08 / len(curves)
            places = (predicted * 10).astype(int).clip(0, 9) / 10 + 0.01 + (i + 0.5) * width
            below.bar(places, number / number.sum(), width, color=colour)
        ax.set(xlim=(0, 1), ylim=(0, 1), ylabel="share that succeeds")
        ax.legend(loc="upper left")
        below.set(xlim=(0, 1), xlabel="predicted chance of success", ylabel="share of all")
        return to_svg(figure)
