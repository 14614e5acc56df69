"""How often 95 % intervals hold the measured force, over trials: the plain GP's and the marginal one's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from stages.science.figures.learning_curves import AVERAGE, finish_panels

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MODELS = (("plain", "#3b6fb6", "s"), ("marginal", "#c1272d", "o"))
TESTS = {"bank": ("-", "the bank"), "unseen_bank": ("--", "an unseen bank")}
NOMINAL_PERCENT = 95


def draw_reliability(reliability: pd.DataFrame, panels: Sequence[str]) -> Figure:
    """Draw the share of forces within the intervals, with its own interval over experiments.

    Parameters
    ----------
    reliability : DataFrame
        Columns tested_on, muscle, trial and, of each model, plain_share, plain_low, plain_high and so on.
    panels : sequence of str
        Values of the muscle column, one panel each.
    """
    from matplotlib.figure import Figure

    columns = min(3, len(panels))
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(3.53 * columns, 2.9 * rows + 0.4), layout="constrained")
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    tests = list(reliability["tested_on"].unique())
    lines = [(test, *model) for test in tests for model in MODELS]
    trials = np.sort(reliability["trial"].unique())
    step = 0.02 * max(1, np.ptp(trials))
    for axis, muscle in zip(axes, panels, strict=False):
        axis.axhline(NOMINAL_PERCENT, color="#2b2b2b", linewidth=1.0, linestyle=":", label=f"{NOMINAL_PERCENT} %")
        for position, (test, model, colour, marker) in enumerate(lines):
            its = reliability[(reliability["tested_on"] == test) & (reliability["muscle"] == muscle)]
            its = its.sort_values("trial")
            share = its[f"{model}_share"]
            ends = [(share - its[f"{model}_low"]).fillna(0.0), (its[f"{model}_high"] - share).fillna(0.0)]
            style, described = TESTS[test]
            axis.errorbar(
                its["trial"] + step * (position - (len(lines) - 1) / 2),
                100 * share,
                100 * np.array(ends),
                color=colour,
                marker=marker,
                linestyle=style,
                markerfacecolor=colour if style == "-" else "white",
                markersize=5,
                linewidth=1.4,
                elinewidth=0.9,
                capsize=2,
                label=f"{model}, {described}",
            )
        axis.set(title="average of the muscles" if muscle == AVERAGE else muscle)
        axis.set_xticks(trials)
        axis.tick_params(labelbottom=True, labelleft=True)
        axis.grid(alpha=0.25)
    for axis in axes[::columns]:
        axis.set_ylabel("forces within\n95 % intervals (%)")
    finish_panels(axes, len(panels))
    return figure
