"""Where the gap lies: a map of channels of muscles by regimes of motion and time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from stages.science.figures.signal_words import shorten

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEFT_OUT = "everywhere"
NOTHING = 1.01
"""Gap over floor below which shares of the difference say nothing."""


def draw_gap_map(gap: pd.DataFrame, channels: pd.DataFrame, level: float) -> Figure:
    """Draw each regime's share of the gap above the floor; a dot marks those that trials confirm after correction.

    A ring marks those that do so without it.

    Parameters
    ----------
    gap : DataFrame
        Columns channel, muscle, regime, share_of_time, share_of_gap, p_value and p_adjusted.
    channels : DataFrame
        Columns channel, muscle and gap_over_floor.
    level : float
        Of significance.
    """
    from matplotlib.figure import Figure

    named = list(dict.fromkeys(gap["channel"]))
    sizes = [gap.loc[gap["channel"] == each, "muscle"].nunique() for each in named]
    figure = Figure(figsize=(10.6, max(0.34 * sum(sizes), 1.4) + 1.75 * len(named)), layout="constrained")
    panels = figure.subplots(len(named), 1, squeeze=False, gridspec_kw={"height_ratios": sizes})[:, 0]
    for axis, channel in zip(panels, named, strict=True):
        over = channels[channels["channel"] == channel].set_index("muscle")["gap_over_floor"]
        image = _draw_channel(axis, gap[gap["channel"] == channel], over, channel, level)
    bar = figure.colorbar(image, ax=list(panels), shrink=0.8, pad=0.01)
    bar.set_label("share of the gap\nabove the floor (%)")
    return figure


def _draw_channel(axis: Any, rows: pd.DataFrame, over: pd.Series, channel: str, level: float) -> Any:
    from matplotlib import colormaps

    rows = rows[rows["regime"] != LEFT_OUT]
    regimes, muscles = list(dict.fromkeys(rows["regime"])), list(dict.fromkeys(rows["muscle"]))
    wide = rows.set_index(["muscle", "regime"])
    shares = wide["share_of_gap"].unstack()[regimes].loc[muscles].to_numpy(dtype=float)
    shown = 100.0 * np.clip(shares, 0.0, 1.0)
    image = axis.imshow(shown, cmap=colormaps["Blues"], vmin=0.0, vmax=100.0, aspect="auto")
    for row, muscle in enumerate(muscles):
        if over.get(muscle, 1.0) < NOTHING:
            axis.text(0.5 * (len(regimes) - 1), row, "no gap above the floor", ha="center", va="center", fontsize=8)
            continue
        for column, regime in enumerate(regimes):
            dark = "white" if shown[row, column] > 55.0 else "#2b2b2b"
            told = f"{shown[row, column]:.0f}{_mark(wide.loc[(muscle, regime)], level)}"
            axis.text(column, row, told, ha="center", va="center", color=dark, fontsize=8)
    axis.set_xticks(range(len(regimes)), regimes, rotation=35, ha="right", fontsize=8)
    axis.set_yticks(range(len(muscles)), [f"{each} ({over.get(each, np.nan):.2f})" for each in muscles])
    axis.set_title(f"{shorten(channel)}: muscle (gap over floor) by regime", loc="left", fontsize=10)
    return image


def _mark(row: Any, level: float) -> str:
    if row["p_adjusted"] <= level:
        return " \u25cf"
    return " \u25cb" if row["p_value"] <= level else ""
