"""Error rates in the end: a bar for each way of identifying, side by side for every muscle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from stages.figures.learning_curves import AVERAGE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BARS = (("#c1272d", ""), ("#6b7480", ""), ("#3b6fb6", "//"), ("#ffffff", "\\\\"), ("#e0b45c", "..."))
INK = "#2b2b2b"


def draw_error_bars(errors: pd.DataFrame, lines: Sequence[str], groups: Sequence[str]) -> Figure:
    """Draw mean and SD of the error rate on the bank as bars, and the mean on the unseen bank as diamonds.

    Parameters
    ----------
    errors : DataFrame
        Columns line, tested_on, muscle, error_rate_mean and error_rate_sd, one row of each.
    lines : sequence of str
        At most five values of the line column: the bars of a group, in this order.
    groups : sequence of str
        Values of the muscle column, in this order.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.6, 4.6), layout="constrained")
    axis: Axes = figure.subplots()
    width = 0.84 / len(lines)
    at = np.arange(len(groups))
    for position, (line, (colour, hatch)) in enumerate(zip(lines, BARS, strict=False)):
        places = at + (position - (len(lines) - 1) / 2) * width
        its = errors[errors["line"] == line].set_index(["tested_on", "muscle"])
        seen = its.loc["bank"].loc[list(groups)]
        axis.bar(
            places,
            100 * seen["error_rate_mean"],
            width,
            yerr=100 * seen["error_rate_sd"].fillna(0.0),
            color=colour,
            hatch=hatch,
            edgecolor=INK,
            linewidth=0.6,
            error_kw={"elinewidth": 0.9, "capsize": 2},
            label=line,
        )
        if "unseen_bank" in its.index:
            unseen = its.loc["unseen_bank"].loc[list(groups)]
            label = "tested on the unseen bank" if position == len(lines) - 1 else None
            axis.plot(
                places,
                100 * unseen["error_rate_mean"],
                "D",
                color="white",
                markeredgecolor=INK,
                markersize=4.5,
                zorder=3,
                label=label,
            )
    axis.set_xticks(at, ["average of\nthe muscles" if name == AVERAGE else name for name in groups])
    axis.set(ylabel="error rate (%)", ylim=(0, None))
    axis.grid(axis="y", alpha=0.25)
    axis.set_axisbelow(True)
    figure.legend(loc="outside upper center", ncols=3, frameon=False, fontsize=9)
    return figure
