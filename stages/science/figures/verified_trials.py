"""Verification trials over time: measured, simulated before and after, and what is left."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import pandas as pd

from stages.science.figures.signal_words import AFTER, BEFORE, MEASURED, QUIET, label

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_verified_trials(
    predictions: pd.DataFrame, channel: str, muscles: Sequence[str], trials: Sequence[int]
) -> Figure:
    """Draw the first muscle's channel in each trial, and below it the residuals of all muscles.

    Parameters
    ----------
    predictions : DataFrame
        Columns trial, time_s, muscle, channel, measured, before and after.
    channel : str
        Which is drawn.
    muscles : sequence of str
        A row of residuals for each.
    trials : sequence of int
        A column for each.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.6, 2.1 + 1.45 * len(muscles)), layout="constrained")
    heights = [1.4, *(1.0 for _ in muscles)]
    panels = figure.subplots(
        len(heights), len(trials), sharex="col", sharey="row", squeeze=False, gridspec_kw={"height_ratios": heights}
    )
    its = predictions[predictions["channel"] == channel]
    for column, trial in enumerate(trials):
        rows = its[its["trial"] == trial]
        _draw_signal(panels[0, column], rows[rows["muscle"] == muscles[0]])
        panels[0, column].set_title(f"trial {trial}", fontsize=10)
        for axis, muscle in zip(panels[1:, column], muscles, strict=True):
            _draw_residual(axis, rows[rows["muscle"] == muscle])
        panels[-1, column].set_xlabel("time (s)", fontsize=9)
    panels[0, 0].set_ylabel(f"{muscles[0]}\n{label(channel)}", fontsize=9)
    unit = label(channel).rpartition("(")[2].rstrip(")")
    for axis, muscle in zip(panels[1:, 0], muscles, strict=True):
        axis.set_ylabel(f"{muscle}\nresidual ({unit})", fontsize=9)
    figure.legend(
        *panels[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False, fontsize=9
    )
    for axis in panels.ravel():
        axis.tick_params(labelsize=8)
        axis.grid(alpha=0.2)
    return figure


def _draw_signal(axis: Any, rows: pd.DataFrame) -> None:
    axis.plot(rows["time_s"], rows["measured"], color=QUIET, linewidth=3.0, label="measured")
    axis.plot(rows["time_s"], rows["before"], color=BEFORE, linewidth=1.1, linestyle="--", label="simulated before")
    axis.plot(rows["time_s"], rows["after"], color=AFTER, linewidth=1.1, label="simulated after")


def _draw_residual(axis: Any, rows: pd.DataFrame) -> None:
    axis.axhline(0.0, color=MEASURED, linewidth=0.8)
    axis.plot(rows["time_s"], rows["measured"] - rows["before"], color=BEFORE, linewidth=0.9)
    axis.plot(rows["time_s"], rows["measured"] - rows["after"], color=AFTER, linewidth=0.9)
