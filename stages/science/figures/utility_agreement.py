"""How far each utility's choice falls short of the best, one panel for each yardstick."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from stages.science.figures.canvas import new_figure
from stages.science.figures.learning_curves import COLOURS

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_agreement(agreement: pd.DataFrame, utilities: Sequence[str], targets: Sequence[str]) -> Figure:
    """Draw each experiment's regret, averaged over trials, and the mean over experiments with its 95 % interval.

    Parameters
    ----------
    agreement : DataFrame
        Columns participant, experiment, target, utility and regret.
    utilities, targets : sequence of str
        Values of those columns, in this order.
    """
    from scipy.stats import t

    figure, (panels,) = new_figure(10.6, 3.6, 1, len(targets), sharey=True)
    for axis, target in zip(panels, targets, strict=True):
        its = agreement[agreement["target"] == target]
        for position, utility in enumerate(utilities):
            rows = its[its["utility"] == utility]
            regret = 100 * rows.groupby(["participant", "experiment"])["regret"].mean().to_numpy()
            spread = np.linspace(-0.18, 0.18, regret.size) if regret.size > 1 else np.zeros(1)
            axis.plot(position + spread, regret, "o", color="#9aa5b1", markersize=4, zorder=2)
            half = t.ppf(0.975, regret.size - 1) * regret.std(ddof=1) / np.sqrt(regret.size) if regret.size > 1 else 0
            colour = COLOURS[0] if position == 0 else COLOURS[1]
            axis.errorbar(position, regret.mean(), half, fmt="_", color=colour, markersize=18, capsize=4, zorder=3)
        axis.set_xticks(range(len(utilities)), utilities, rotation=30, ha="right")
        axis.set_title(f"samples {target}")
        axis.grid(axis="y", alpha=0.25)
    panels[0].set_ylabel("information forgone (%)")
    panels[0].set_ylim(bottom=0)
    return figure
