"""Error rates in the end: a bar for each way of identifying, side by side for every muscle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from stages.science.figures.canvas import new_figure
from stages.science.figures.learning_curves import AVERAGE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BARS = (("#c1272d", ""), ("#6b7480", ""), ("#3b6fb6", "//"), ("#ffffff", "\\\\"), ("#e0b45c", "..."))
INK = "#2b2b2b"


def draw_error_bars(errors: pd.DataFrame, lines: Sequence[str], groups: Sequence[str]) -> Figure:
    """Draw mean and SD of the error rate on the bank as bars, and the mean on the unseen bank as diamonds.

    Parameters
    ----------
    errors : DataFrame
        Columns line, tested_on, muscle, error_rate_mean and error_rate_sd, one row of each.
    lines, groups : sequence of str
        At most five values of the line column, the bars of a group, and values of the muscle column, in this order.
    """
    figure, ((axis,),) = new_figure(10.6, 4.6)
    width = 0.84 / len(lines)
    at = np.arange(len(groups))
    wide = 100 * errors.set_index(["tested_on", "muscle", "line"])[["error_rate_mean", "error_rate_sd"]].unstack("line")
    means, spread = wide["error_rate_mean"], wide["error_rate_sd"].fillna(0.0)
    handles: list[Any] = []
    places = []
    for position, (line, (colour, hatch)) in enumerate(zip(lines, BARS, strict=False)):
        places.append(at + (position - (len(lines) - 1) / 2) * width)
        mean, sd = (found.loc["bank"].loc[list(groups), line] for found in (means, spread))
        bar = {"color": colour, "hatch": hatch, "edgecolor": INK, "linewidth": 0.6, "label": line}
        handles.append(axis.bar(places[-1], mean, width, yerr=sd, error_kw={"elinewidth": 0.9, "capsize": 2}, **bar))
    if "unseen_bank" in means.index:
        unseen = means.loc["unseen_bank"].loc[list(groups), list(lines)].to_numpy().T.ravel()
        mark = {"color": "white", "markeredgecolor": INK, "markersize": 4.5, "zorder": 3}
        handles += axis.plot(np.ravel(places), unseen, "D", label="tested on the unseen bank", **mark)
    axis.set_xticks(at, ["average of\nthe muscles" if name == AVERAGE else name for name in groups])
    axis.set(ylabel="error rate (%)", ylim=(0, None))
    axis.grid(axis="y", alpha=0.25)
    axis.set_axisbelow(True)
    figure.legend(handles=handles, loc="outside upper center", ncols=3, frameon=False, fontsize=9)
    return figure
