"""Learning curves: error rate over trials, one panel for each muscle and one for their average."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import pandas as pd

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AVERAGE = "mean"
COLOURS = ("#c1272d", "#3b6fb6", "#6b7480", "#d08a1d", "#4b8f5a", "#8059a5", "#2b2b2b")
MOST_BARS = 4
"""Lines beyond which only the first has bars: more would hide each other."""
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
STYLES = ("-", "--", "-.", ":")


def draw_learning_curves(
    summary: pd.DataFrame,
    lines: Sequence[str],
    panels: Sequence[str],
    by: str = "arm",
    title: str | None = "trajectory chosen by",
    styles: Sequence[str] = ("-",),
    apart: float = 0.09,
    cut: bool = False,
) -> Figure:
    """Draw the mean of the error rate over trials, and its SD: of every line, or of the first one of many.

    Parameters
    ----------
    summary : DataFrame
        Columns trial, muscle, error_rate_mean, error_rate_sd and the one named by `by`.
    lines : sequence of str
        Values of that column, one line each, in this order.
    panels : sequence of str
        Values of the muscle column, one panel each.
    by : str
        What tells the lines apart.
    title : str or None
        Of the legend.
    styles : sequence of str
        Line styles, taken in turn.
    apart : float
        Horizontal distance of the lines' points (trials).
    cut : bool
        Whether the panels end above the highest mean, so that large SDs do not flatten the means.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    columns = min(3, len(panels))
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(3.9 * columns, 3.1 * rows + 0.4), layout="constrained")
    axes = figure.subplots(rows, columns, sharex=True, squeeze=False).ravel()
    for axis, muscle in zip(axes, panels, strict=False):
        panel = summary[(summary["muscle"] == muscle) & summary[by].isin(lines)]
        for position, line in enumerate(lines):
            its = panel[panel[by] == line]
            axis.errorbar(
                its["trial"] + apart * (position - (len(lines) - 1) / 2),
                100 * its["error_rate_mean"],
                100 * its["error_rate_sd"].fillna(0.0) if len(lines) <= MOST_BARS or position == 0 else None,
                color=COLOURS[position % len(COLOURS)],
                marker=MARKERS[position % len(MARKERS)],
                linestyle=styles[position % len(styles)],
                markersize=3.5,
                linewidth=1.4,
                elinewidth=0.8,
                capsize=2,
                label=line,
            )
        axis.set(title="average of the muscles" if muscle == AVERAGE else muscle, ylabel="error rate (%)")
        axis.set_ylim(0, 115 * panel["error_rate_mean"].max() if cut else None)
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
        axis.tick_params(labelbottom=True)
        axis.grid(alpha=0.25)
    finish_panels(axes, len(panels), title)
    return figure


def finish_panels(axes: Any, count: int, title: str | None = None) -> None:
    """Label the lowest panels' abscissa and put the legend into a spare panel, or the first."""
    for axis in axes[count:]:
        axis.axis("off")
    for axis in axes[max(0, count - min(3, count)) : count]:
        axis.set_xlabel("trial")
    spare, place = (axes[count], "center") if count < len(axes) else (axes[0], "best")
    spare.legend(*axes[0].get_legend_handles_labels(), title=title, loc=place, frameon=False)
