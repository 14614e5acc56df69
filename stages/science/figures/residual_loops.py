"""Loops: the residual along a signal, apart for the two directions of motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pandas as pd

from stages.science.figures.signal_words import AFTER, BEFORE, MEASURED, label, shorten

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STYLES = {"rising": (BEFORE, "-"), "falling": (AFTER, "--"), "both": (MEASURED, "-")}
DIRECTIONS = {"force_n": ("while shortening", "while lengthening"), "pressure_kpa": ("after a rise", "after a fall")}
"""What rising and falling mean in a channel."""


def draw_residual_loops(loops: pd.DataFrame) -> Figure:
    """Draw the mean residual with two standard errors over trials, a row per channel and a panel per muscle.

    Parameters
    ----------
    loops : DataFrame
        Columns channel, muscle, unit, variable, direction, x, mean and error.
    """
    from matplotlib.figure import Figure

    channels, muscles = list(dict.fromkeys(loops["channel"])), list(dict.fromkeys(loops["muscle"]))
    width = min(10.6, 2.65 * len(muscles) + 0.6)
    figure = Figure(figsize=(width, 2.4 * len(channels) + 0.4), layout="constrained")
    panels = figure.subplots(len(channels), len(muscles), squeeze=False)
    for row, channel in enumerate(channels):
        for axis, muscle in zip(panels[row], muscles, strict=True):
            its = loops[(loops["channel"] == channel) & (loops["muscle"] == muscle)]
            if its.empty:
                axis.axis("off")
                continue
            draw_loop(axis, its, "mean", "error", channel)
            axis.axhline(0.0, color=MEASURED, linewidth=0.8)
            axis.set_title(muscle, fontsize=10)
            axis.set_xlabel(label(its["variable"].iloc[0]), fontsize=9)
            axis.tick_params(labelsize=8)
        unit = loops.loc[loops["channel"] == channel, "unit"].iloc[0]
        panels[row, 0].set_ylabel(f"{shorten(channel)}, measured\nless simulated ({unit})", fontsize=9)
        panels[row, 0].legend(frameon=False, fontsize=8)
    return figure


def draw_loop(axis: Any, rows: pd.DataFrame, mean: str, error: str, channel: str) -> None:
    """Draw one panel's lines with bands, in the colours of the directions."""
    words = dict(zip(("rising", "falling"), DIRECTIONS.get(channel, ("rising", "falling")), strict=True))
    for direction, its in rows.groupby("direction", sort=False):
        colour, style = STYLES[str(direction)]
        axis.plot(
            its["x"],
            its[mean],
            color=colour,
            linestyle=style,
            linewidth=1.6,
            label=words.get(str(direction), "measured"),
        )
        axis.fill_between(
            its["x"], its[mean] - 2 * its[error], its[mean] + 2 * its[error], color=colour, alpha=0.18, linewidth=0
        )
