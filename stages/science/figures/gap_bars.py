"""The gap of every channel over its noise floor, beside the smallest gap of interest."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pandas as pd

from stages.science.figures.signal_words import AFTER, BEFORE, MEASURED, shorten

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_gap_bars(channels: pd.DataFrame, smallest_gap: float) -> Figure:
    """Draw a bar for each channel of each muscle, with the upper limit of its gap.

    Parameters
    ----------
    channels : DataFrame
        Columns channel, muscle, unit, gap, noise_floor, gap_over_floor and upper.
    smallest_gap : float
        Over the floor; below it nothing is missing.
    """
    from matplotlib.figure import Figure

    rows = channels.sort_values(["channel", "muscle"], ascending=[False, True]).reset_index(drop=True)
    figure = Figure(figsize=(10.6, 0.36 * len(rows) + 1.3), layout="constrained")
    axis = figure.subplots()
    place = range(len(rows))
    colours = [BEFORE if gap > smallest_gap else AFTER for gap in rows["gap_over_floor"]]
    axis.barh(place, rows["gap_over_floor"], color=colours, height=0.62)
    above = (rows["upper"] - rows["gap_over_floor"]).clip(lower=0.0)
    axis.errorbar(rows["gap_over_floor"], place, xerr=[0.0 * above, above], fmt="none", ecolor=MEASURED, capsize=3)
    axis.axvline(1.0, color=MEASURED, linewidth=1.0)
    axis.axvline(
        smallest_gap, color=MEASURED, linewidth=1.2, linestyle="--", label=f"smallest of interest, {smallest_gap:g}"
    )
    furthest = max(float(rows[["gap_over_floor", "upper"]].max().max()), smallest_gap)
    for each, row in zip(place, rows.to_dict("records"), strict=True):
        at = max(float(row["gap_over_floor"]), float(row["upper"]), smallest_gap)
        told = f"{row['gap']:.3g} {row['unit']}; floor {row['noise_floor']:.3g} {row['unit']}"
        axis.annotate(told, (at, each), (6, 0), textcoords="offset points", va="center", fontsize=8)
    axis.set_yticks(place, [f"{shorten(row['channel'])}, {row['muscle']}" for row in rows.to_dict("records")])
    axis.invert_yaxis()
    axis.set_xlim(0.0, 1.25 * furthest)
    axis.set_xlabel("gap over noise floor (1)")
    axis.legend(frameon=False, loc="lower right")
    axis.spines[["top", "right"]].set_visible(False)
    return figure
