"""The candidates of the first round: how probable each is, and the gap that it would leave."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pandas as pd

from stages.science.figures.canvas import new_figure
from stages.science.figures.signal_words import AFTER, BEFORE, MEASURED, QUIET, spell

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEAST_PROBABILITY = 0.005


def draw_candidate_ranking(ranking: pd.DataFrame) -> Figure:
    """Draw probabilities as bars, and held-out gaps as points beside the gap that there is.

    Candidates that say nothing are left out; the most probable ones come first.

    Parameters
    ----------
    ranking : DataFrame
        Of one round: columns name, probability, heldout_gap and absorbed.
    """
    always = ranking["name"].isin(["none", "unknown"])
    now = float(ranking.loc[ranking["name"] == "none", "heldout_gap"].iloc[0])
    tells = (ranking["probability"] >= LEAST_PROBABILITY) | (ranking["heldout_gap"] < now) | ranking["absorbed"]
    order = ["absorbed", "probability", "heldout_gap"]
    rows = ranking[always | tells].sort_values(order, ascending=[True, False, True]).reset_index(drop=True)
    figure, ((left, right),) = new_figure(10.6, 0.27 * len(rows) + 1.1, 1, 2, sharey=True, width_ratios=[1.0, 1.1])
    place = range(len(rows))
    left.barh(place, rows["probability"], color=[BEFORE if each == 0 else AFTER for each in place], height=0.66)
    for each, row in enumerate(rows.to_dict("records")):
        p = float(row["probability"])
        told = "absorbed" if row["absorbed"] else "> 0.99" if p > 0.995 else "< 0.01" if p < 0.005 else f"{p:.2f}"
        left.annotate(told, (p, each), (4, 0), textcoords="offset points", va="center", fontsize=8)
    left.set_yticks(place, [spell(each) for each in rows["name"]])
    left.invert_yaxis()
    left.set(xlim=(0.0, 1.18), xlabel="probability (1)", xticks=[0.0, 0.25, 0.5, 0.75, 1.0])
    right.axvline(100.0 * now, color=MEASURED, linestyle="--", linewidth=1.0, label="as it is")
    right.legend(frameon=False, fontsize=8, loc="lower left")
    closed = ~rows["absorbed"]
    right.plot(100.0 * rows["heldout_gap"][closed], rows.index[closed], "o", color=AFTER)
    right.plot(100.0 * rows["heldout_gap"][~closed], rows.index[~closed], "o", color=QUIET, fillstyle="none")
    right.set(xlim=(0.0, None), xlabel="gap with it, trials left out (% of range)")
    for axis in (left, right):
        axis.grid(axis="x", alpha=0.25)
        axis.spines[["top", "right"]].set_visible(False)
    return figure
