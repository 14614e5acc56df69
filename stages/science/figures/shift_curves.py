"""Learning curves of replayed experiments with and without time shifts, one panel for each set of recordings."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pandas as pd

from stages.science.figures.learning_curves import STYLES, draw_learning_curves

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TITLES = {"bank": "tested on the bank", "unseen_bank": "tested on an unseen bank"}


def draw_shift_curves(summary: pd.DataFrame) -> Figure:
    """Draw mean and SD of the error rate over trials, one line for each amplitude.

    Parameters
    ----------
    summary : DataFrame
        Columns tested_on, amplitude_s (0 = no shift), trial, error_rate_mean and error_rate_sd, in the order of panels
        and lines.
    """
    names = {each: f"up to {each:g} s" if each else "none" for each in summary["amplitude_s"].unique()}
    told = summary.assign(line=summary["amplitude_s"].map(names), muscle=summary["tested_on"].map(TITLES))
    panels = list(told["muscle"].unique())
    return draw_learning_curves(told, list(names.values()), panels, "line", "time shift", STYLES, apart=0.12)
