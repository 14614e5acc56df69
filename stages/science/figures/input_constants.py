"""Sets of constants that were tried, and how well each lets the models explain their points."""

import pandas as pd

from stages.science.figures.canvas import COLOURS, Figure, new_figure

LOWEST = 60.0
"""Scores so far below the best, nats, are left out."""


def draw_constants(tried: pd.DataFrame, constants: pd.DataFrame) -> Figure:
    """Draw the score over each constant, less the best; rows are of `constants_tried` and `input_constants`."""
    names = constants["constant"].to_list()
    figure, (axes,) = new_figure(4.2 * max(len(names), 1), 3.6, 1, max(len(names), 1), sharey=True)
    score = tried["score"] - tried["score"].max()
    for axis, row in zip(axes, constants.to_dict("records"), strict=False):
        name = str(row["constant"])
        others = [each for each in names if each != name]
        best = constants.set_index("constant")["identified"]
        alike = (tried[others] == best[others]).all(axis=1).to_numpy()
        order = tried.loc[alike, name].sort_values().index
        axis.plot(tried.loc[order, name], score[order], "o-", color=COLOURS[0], label="the others at their best")
        axis.plot(tried.loc[~alike, name], score[~alike], "o", color=COLOURS[2], fillstyle="none", label="other sets")
        axis.axvline(row["assumed"], color=COLOURS[1], linestyle=":", label="assumed")
        axis.set_xscale("log", base=2)
        axis.xaxis.set_major_formatter("{x:.3g}")
        axis.set(xlabel=name, ylim=(max(-LOWEST, 1.1 * score.min()) - 1.0, 2.0))
        axis.grid(alpha=0.25)
    axes[0].set_ylabel("score less the best (nats)")
    axes[0].legend(frameon=False, fontsize=8)
    return figure
