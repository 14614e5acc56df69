"""Error rates in the end: a bar for each way of identifying, side by side for every muscle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from stages.figures.learning_curves import AVERAGE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STYLES = (("#c1272d", ""), ("#5f6873", ""), ("#b9c0c8", ""), ("#ffffff", "//"), ("#e9b872", ".."))


def draw_error_bars(errors: pd.DataFrame, lines: Sequence[str], groups: Sequence[str]) -> Figure:
    """Draw mean and SD of the error rate on the bank, and the mean on the unseen bank as a diamond.

    Parameters
    ----------
    errors : DataFrame
        Columns line, tested_on, muscle, error_rate_mean and error_rate_sd, one row of each.
    lines : sequence of str
        Values of the line column: bars of a group, in this order.
    groups : sequence of str
        Values of the muscle column, in this order.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.6, 4.4), layout="constrained")
    axis = figure.subplots()
    width = 0.84 / len(lines)
    at = np.arange(len(groups))
    for position, line in enumerate(lines):
        colour, hatch = STYLES[position % len(STYLES)]
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
            edgecolor="#2b2b2b",
            linewidth=0.6,
            error_kw={"elinewidth": 0.9, "capsize": 2},
            label=line,
        )
        if "unseen_bank" in its.index:
            unseen = its.loc["unseen_bank"].loc[list(groups)]
            axis.plot(places, 100 * unseen["error_rate_mean"], "D", color="#1d2530", markersize=4, zorder=3)
    axis.set_xticks(at, ["average" if name == AVERAGE else name for name in groups])
    axis.set(ylabel="error rate (%)", ylim=(0, None))
    axis.grid(axis="y", alpha=0.25)
    axis.set_axisbelow(True)
    axis.legend(frameon=False, fontsize=9, ncols=3, loc="upper center", bbox_to_anchor=(0.5, 1.16))
    return figure
