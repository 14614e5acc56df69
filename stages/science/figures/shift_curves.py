"""Learning curves of replayed experiments with and without time shifts, one panel for each set of recordings."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pandas as pd

from stages.science.figures.learning_curves import COLOURS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MARKERS = ("o", "s", "^", "D", "v", "P", "X")
LINES = ("-", "--", "-.", ":")
TITLES = {"bank": "tested on the bank", "unseen_bank": "tested on an unseen bank"}


def draw_shift_curves(summary: pd.DataFrame) -> Figure:
    """Draw mean and SD of the error rate over trials, one line for each amplitude.

    Parameters
    ----------
    summary : DataFrame
        Columns tested_on, amplitude_s (0 = no shift), trial, error_rate_mean and error_rate_sd, in the order of panels
        and lines.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    panels = list(summary["tested_on"].unique())
    amplitudes = list(summary["amplitude_s"].unique())
    figure = Figure(figsize=(4.9 * len(panels) + 0.8, 4.0), layout="constrained")
    axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for axis, panel in zip(axes, panels, strict=True):
        for position, amplitude_s in enumerate(amplitudes):
            its = summary[(summary["tested_on"] == panel) & (summary["amplitude_s"] == amplitude_s)]
            axis.errorbar(
                its["trial"] + 0.12 * (position - (len(amplitudes) - 1) / 2),
                100 * its["error_rate_mean"],
                100 * its["error_rate_sd"].fillna(0.0),
                color=COLOURS[position % len(COLOURS)],
                marker=MARKERS[position % len(MARKERS)],
                linestyle=LINES[position % len(LINES)],
                markersize=4.5,
                linewidth=1.4,
                elinewidth=0.8,
                capsize=2,
                label=f"up to {amplitude_s:g} s" if amplitude_s else "none",
            )
        axis.set(title=TITLES.get(panel, panel), xlabel="trial")
        axis.set_ylim(bottom=0)
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
        axis.tick_params(labelleft=True)
        axis.grid(alpha=0.25)
    axes[0].set_ylabel("error rate, average of the muscles (%)")
    axes[-1].legend(title="time shift", frameon=False)
    return figure
