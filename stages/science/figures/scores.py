"""How often a search is right: shares against targets, names against truths, probabilities against outcomes."""

import numpy as np
import pandas as pd

from stages.science.figures.canvas import Figure, new_figure

DARK, BLUE, RED = "#2b2b2b", "#3b6fb6", "#c1272d"
UNNAMED = {"no_discrepancy": "(nothing)", "unexplained": "(unexplained)"}


def draw_rates(rates: pd.DataFrame) -> Figure:
    """Draw each share or median with its interval and its target.

    Columns are measure, magnitude, n, value, low, high, target, at_most and met; rows without sessions are left out.
    """
    shown = rates[rates["n"] > 0].iloc[::-1].reset_index(drop=True)
    figure, ((axis,),) = new_figure(8.6, 1.3 + 0.3 * len(shown), grid="x")
    for place, row in enumerate(shown.to_dict("records")):
        colour = BLUE if row["met"] else RED
        axis.plot([100 * row["low"], 100 * row["high"]], [place, place], color=colour, linewidth=1.6)
        face = "white" if row["at_most"] else colour
        axis.plot(100 * row["value"], place, "o", color=colour, markerfacecolor=face, markersize=6)
        axis.plot([100 * row["target"]] * 2, [place - 0.36, place + 0.36], color=DARK, linewidth=2.0)
    labels = [
        f"{row['measure']}{'' if row['magnitude'] == 'all' else ', ' + row['magnitude']} (n = {row['n']})"
        for row in shown.to_dict("records")
    ]
    axis.set_yticks(range(len(shown)), labels, fontsize=9)
    axis.set(xlabel="share of sessions, or median share of the gap (%)", xlim=(-3, 103))
    axis.plot([], [], "o-", color=BLUE, label="target met")
    axis.plot([], [], "o-", color=RED, label="target missed")
    axis.plot([], [], "o", color=DARK, markerfacecolor="white", label="a fault, to stay below")
    axis.plot([], [], "|", color=DARK, markersize=11, markeredgewidth=2.0, label="target")
    figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    return figure


def draw_confusion(sessions: pd.DataFrame) -> Figure:
    """Draw what was said first, by what was hidden: columns hidden, named (names joined by +, as added) and status."""
    first = sessions["named"].str.split("+").str[0]
    said = first.where(first != "", sessions["status"].map(UNNAMED)).str.replace("_", " ")
    hidden = sessions["hidden"].where(sessions["hidden"] != "", "(nothing)").str.replace("_", " ")
    counts = pd.crosstab(hidden, said)
    rows = list(dict.fromkeys(hidden))
    columns = [str(name) for name in rows if name in counts] + sorted({str(name) for name in counts} - set(rows))
    counts = counts.loc[rows, columns]
    shares = counts.div(counts.sum(axis=1), axis=0).to_numpy()
    figure, ((axis,),) = new_figure(3.4 + 0.36 * len(columns), 2.4 + 0.27 * len(rows))
    image = axis.imshow(100 * shares, cmap="Blues", vmin=0, vmax=100, aspect="auto")
    for y, x in zip(*np.nonzero(counts.to_numpy()), strict=True):
        tone = "white" if shares[y, x] > 0.55 else DARK
        axis.text(x, y, str(counts.iloc[y, x]), ha="center", va="center", color=tone, fontsize=8)
    axis.set_xticks(range(len(columns)), columns, rotation=55, ha="right", rotation_mode="anchor", fontsize=8.5)
    axis.set_yticks(range(len(rows)), rows, fontsize=8.5)
    axis.set(xlabel="said first", ylabel="hidden")
    figure.colorbar(image, ax=axis, label="share of the sessions of a row (%)", fraction=0.03)
    return figure


def draw_reliability_of_names(reliability: pd.DataFrame) -> Figure:
    """Draw the share of right names against the mean probability that was said.

    Columns are said, right, low, high and n; bins without names are left out.
    """
    shown = reliability[reliability["n"] > 0]
    figure, ((axis,),) = new_figure(5.2, 4.4, grid="both")
    axis.plot([0, 100], [0, 100], color=DARK, linestyle=":", linewidth=1.0, label="said as often as right")
    ends = 100 * np.array([shown["right"] - shown["low"], shown["high"] - shown["right"]])
    axis.errorbar(100 * shown["said"], 100 * shown["right"], np.maximum(ends, 0.0), fmt="o", color=BLUE, capsize=3)
    for row in shown.to_dict("records"):
        place = (100 * row["said"], 100 * row["right"])
        axis.annotate(f"{row['n']}", place, (6, 6), textcoords="offset points", fontsize=8.5)
    axis.set(xlabel="probability said (%)", ylabel="right names (%)", xlim=(0, 108), ylim=(-3, 108))
    axis.legend(loc="upper left", frameon=False, fontsize=9)
    return figure
