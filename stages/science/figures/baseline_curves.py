"""Learning curves of the design and of one baseline, one panel for each muscle and one for their average."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import pandas as pd

from stages.science.figures.learning_curves import AVERAGE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CURVES = (("#c1272d", "o", "-"), ("#6b7480", "s", "--"))


def draw_baseline_curves(summary: pd.DataFrame, lines: Sequence[str], panels: Sequence[str]) -> Figure:
    """Draw mean and SD of the error rate over trials, a panel for each muscle.

    Parameters
    ----------
    summary : DataFrame
        Columns line, trial, muscle, error_rate_mean and error_rate_sd.
    lines : sequence of str
        At most two values of the line column: the design, then its baseline.
    panels : sequence of str
        Values of the muscle column, one panel each.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    columns = min(3, len(panels))
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(3.55 * columns, 3.0 * rows + 0.4), layout="constrained")
    axes = figure.subplots(rows, columns, sharex=True, squeeze=False).ravel()
    for axis, muscle in zip(axes, panels, strict=False):
        panel = summary[(summary["muscle"] == muscle) & summary["line"].isin(lines)]
        for line, (colour, marker, style) in zip(lines, CURVES, strict=False):
            its = panel[panel["line"] == line]
            axis.errorbar(
                its["trial"],
                100 * its["error_rate_mean"],
                100 * its["error_rate_sd"].fillna(0.0),
                color=colour,
                marker=marker,
                linestyle=style,
                markersize=4,
                linewidth=1.5,
                elinewidth=0.9,
                capsize=2,
                label=line,
            )
        axis.set(title="average of the muscles" if muscle == AVERAGE else muscle, ylabel="error rate (%)")
        axis.set_ylim(0, 115 * panel["error_rate_mean"].max())  # SDs beyond it are cut, not the means made flat
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
        axis.tick_params(labelbottom=True)
        axis.grid(alpha=0.25)
    for axis in axes[len(panels) :]:
        axis.axis("off")
    for axis in axes[max(0, len(panels) - columns) : len(panels)]:
        axis.set_xlabel("trial")
    spare = axes[len(panels)] if len(panels) < len(axes) else axes[0]
    spare.legend(*axes[0].get_legend_handles_labels(), loc="center" if spare is not axes[0] else "best", frameon=False)
    return figure
