"""Pictures of curves: lines with bands flow in, a picture flows out."""

from __future__ import annotations

from pipeline.page import Picture
from pipeline.review.curves import Curves
from pipeline.review.pictures import make_picture, new_figure, shorten_label

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#1d2530", "#e69f00", "#56b4e9", "#8c6d31")
STYLES = ("-", "--", ":", "-.")
MARKERS = "os^Dv<>P"
MOST_LINES = 24
LONGEST_LINE_LABEL = 34


def draw_curves(curves: Curves) -> Picture:
    """Draw the lines of a curve, told apart by colour, marker and style."""
    lines = curves.lines[:MOST_LINES]
    rows = -(-len(lines) // 2)
    figure, axes = new_figure(6.0, 3.7 + 0.19 * rows)
    for index, line in enumerate(lines):
        points = line.points
        colour = COLOURS[index % len(COLOURS)]
        x, mean, half = (points[each].to_numpy() for each in ("x", "mean", "half"))
        axes.fill_between(x, mean - half, mean + half, color=colour, alpha=0.16, lw=0)
        style = STYLES[(index // len(COLOURS)) % len(STYLES)]
        marker = MARKERS[index % len(MARKERS)]
        label = shorten_label(line.label, LONGEST_LINE_LABEL)
        every = max(1, len(x) // 15)
        axes.plot(x, mean, style, color=colour, marker=marker, ms=4.5, markevery=every, lw=1.6, label=label)
    axes.set(xlabel=curves.x, ylabel=curves.y)
    if all(float(each).is_integer() for line in lines for each in line.points["x"]):
        axes.xaxis.get_major_locator().set_params(integer=True)
    figure.legend(loc="outside lower left", ncols=2, fontsize=8, frameon=False, borderpad=0.1)
    left = len(curves.lines) - len(lines)
    return make_picture(figure, f"{curves.told}{f'; {left} more lines are in the table alone' if left else ''}.")
