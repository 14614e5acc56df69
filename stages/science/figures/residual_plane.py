"""The residual over the state plane: contraction by pressure for force, command by its rate for pressure."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from stages.science.figures.signal_words import label, shorten

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEAST_SCALE = 1.0
COMPRESSED = ("command_rate",)
"""Signals whose steps are so large that the rest would not be seen on an even scale."""
TICKS = (-10000.0, -1000.0, -100.0, 0.0, 100.0, 1000.0, 10000.0)


def draw_residual_plane(plane: pd.DataFrame) -> Figure:
    """Draw the mean residual over the noise floor, a row for each channel and a panel for each muscle.

    Parameters
    ----------
    plane : DataFrame
        Columns channel, muscle, across, along, x, y and over_floor.
    """
    from matplotlib.figure import Figure

    channels, muscles = list(dict.fromkeys(plane["channel"])), list(dict.fromkeys(plane["muscle"]))
    width = min(10.6, 2.6 * len(muscles) + 1.4)
    figure = Figure(figsize=(width, 2.5 * len(channels) + 0.4), layout="constrained")
    panels = figure.subplots(len(channels), len(muscles), squeeze=False)
    limit = max(LEAST_SCALE, float(np.quantile(plane["over_floor"].abs(), 0.98)))
    for row, channel in enumerate(channels):
        for axis, muscle in zip(panels[row], muscles, strict=True):
            its = plane[(plane["channel"] == channel) & (plane["muscle"] == muscle)]
            if its.empty:
                axis.axis("off")
                continue
            dots = axis.scatter(
                its["x"], its["y"], c=its["over_floor"], s=11, marker="s", cmap="PuOr_r", vmin=-limit, vmax=limit
            )
            if its["along"].iloc[0] in COMPRESSED:
                low, high = its["y"].min(), its["y"].max()
                axis.set_yscale("asinh", linear_width=max(float(its["y"].abs().median()), 1.0))
                axis.set_yticks([each for each in TICKS if low <= each <= high], minor=False)
                axis.yaxis.set_major_formatter("{x:g}")
                axis.minorticks_off()
            axis.set_xlabel(label(its["across"].iloc[0]), fontsize=9)
            axis.set_ylabel(label(its["along"].iloc[0]), fontsize=9)
            axis.set_title(f"{shorten(channel)}, {muscle}", fontsize=10)
            axis.tick_params(labelsize=8)
            axis.set_facecolor("#eef1f4")
    figure.colorbar(dots, ax=panels.ravel().tolist(), shrink=0.7, pad=0.01).set_label(
        "measured less simulated, over noise floor (1)"
    )
    return figure
