"""What stays unexplained, over the input that tells most of it, beside what a Gaussian process makes of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pandas as pd

from stages.science.figures.canvas import new_figure
from stages.science.figures.signal_words import AFTER, BEFORE, MEASURED, shorten

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ABREAST = 4


def draw_unexplained(averages: pd.DataFrame) -> Figure:
    """Draw mean residuals as bars of two standard errors and the process as lines with bands, a panel for each cell.

    Parameters
    ----------
    averages : DataFrame
        Columns channel, muscle, unit, variable, beside, x, mean, error, said and deviation.
    """
    cells = list(averages.groupby(["channel", "muscle"], sort=False))
    columns = min(len(cells), ABREAST)
    rows = -(-len(cells) // ABREAST)
    figure, panels = new_figure(max(5.3, 2.65 * columns + 0.6), 3.1 * rows + 0.3, rows, columns)
    for axis in panels.flat[len(cells) :]:
        axis.axis("off")
    for place, (axis, (_, its)) in enumerate(zip(panels.flat, cells, strict=False)):
        for (beside, line), colour in zip(its.groupby("beside", sort=False), (BEFORE, AFTER), strict=False):
            bars = {"fmt": "o", "color": colour, "markersize": 3, "elinewidth": 0.9}
            axis.errorbar(line["x"], line["mean"], 2 * line["error"], **bars)
            axis.plot(line["x"], line["said"], color=colour, linewidth=1.6, label=str(beside) or None)
            low, high = line["said"] - 2 * line["deviation"], line["said"] + 2 * line["deviation"]
            axis.fill_between(line["x"], low, high, color=colour, alpha=0.18, linewidth=0)
        first = its.iloc[0]
        axis.axhline(0.0, color=MEASURED, linewidth=0.8)
        axis.set_title(f"{first['muscle']}: {shorten(first['channel'])}", fontsize=10)
        axis.set_xlabel(first["variable"], fontsize=9)
        axis.tick_params(labelsize=8)
        if place % ABREAST == 0:
            axis.set_ylabel(f"measured less simulated ({first['unit']})", fontsize=9)
        if its["beside"].iloc[0]:
            axis.legend(frameon=False, fontsize=7)
    return figure
