"""Error rates of each muscle and of their average: over trials, and in the end for each way of identifying."""

from collections.abc import Sequence
from itertools import cycle
from typing import Any

import numpy as np
import pandas as pd

from stages.science.figures.canvas import ARMS, COLOURS, LINES, Figure, new_figure, spell_arm

AVERAGE = "mean"
MOST_BARS = 4
"""Lines beyond which only the first has bars: more would hide each other."""
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
BARS = (("#c1272d", ""), ("#6b7480", ""), ("#3b6fb6", "//"), ("#ffffff", "\\\\"), ("#e0b45c", "..."))
INK = "#2b2b2b"
TITLES = {"task": "tested on the task", "bank": "tested on the bank", "unseen_bank": "tested on an unseen bank"}


def draw_learning_curves(
    summary: pd.DataFrame,
    lines: Sequence[str],
    panels: Sequence[str],
    by: str = "arm",
    title: str | None = "trajectory chosen by",
    styles: Sequence[str] = ("-",),
    apart: float = 0.09,
    cut: bool = False,
) -> Figure:
    """Draw the mean of the error rate over trials, and its SD: of every line, or of the first one of many.

    Columns are trial, muscle, error_rate_mean, error_rate_sd and the one named by `by`, of which `title` tells; lines
    and panels are values of that one and of muscle (or test sets), line styles serve in turn. The lines' points lie
    `apart` from each other, in trials. Panels that are `cut` end above the highest mean, which large SDs would flatten.
    """
    from matplotlib.ticker import MaxNLocator

    names = {AVERAGE: "average of the muscles", **TITLES}
    taken = {ARMS.get(line) for line in lines}
    spare = cycle([each for each in COLOURS if each not in taken])
    colours = {line: ARMS.get(line) or next(spare) for line in lines}
    figure, axes = begin_panels(len(panels), 4.2 if len(panels) < 3 else 3.4, 3.1)
    for axis, muscle in zip(axes, panels, strict=False):
        panel = summary[(summary["muscle"] == muscle) & summary[by].isin(lines)]
        for position, line in enumerate(lines):
            its = panel[panel[by] == line]
            trial = its["trial"] + apart * (position - (len(lines) - 1) / 2)
            spread = 100 * its["error_rate_sd"].fillna(0.0) if len(lines) <= MOST_BARS or position == 0 else None
            colour, marker = colours[line], MARKERS[position % len(MARKERS)]
            bars: dict[str, Any] = {"markersize": 3.5, "linewidth": 1.4, "elinewidth": 0.8, "capsize": 2, "label": line}
            bars |= {"color": colour, "marker": marker, "linestyle": styles[position % len(styles)]}
            axis.errorbar(trial, 100 * its["error_rate_mean"], spread, **bars)
        axis.set(ylabel="error rate (%)")
        axis.set_title(names.get(muscle, muscle), fontsize=10)
        axis.set_ylim(0, 115 * panel["error_rate_mean"].max() if cut else None)
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
        axis.tick_params(labelbottom=True)
    finish_panels(figure, axes, len(panels), title)
    return figure


def draw_shift_curves(summary: pd.DataFrame) -> Figure:
    """Draw learning curves of replayed experiments, a line for each time shift, a panel for each set of recordings.

    Columns are tested_on, amplitude_s (0 = no shift), trial, error_rate_mean and error_rate_sd, in the order of panels
    and lines.
    """
    names = {each: f"up to {each:g} s" if each else "none" for each in summary["amplitude_s"].unique()}
    told = summary.assign(line=summary["amplitude_s"].map(names), muscle=summary["tested_on"].map(TITLES))
    panels = list(told["muscle"].unique())
    return draw_learning_curves(told, list(names.values()), panels, "line", "time shift", LINES, apart=0.12)


def draw_error_bars(errors: pd.DataFrame, lines: Sequence[str], groups: Sequence[str]) -> Figure:
    """Draw mean and SD of the error rate on the bank as bars, and the mean on the unseen bank as diamonds.

    Errors have a row for each line (a bar, five at most), tested_on and muscle (a group of bars), with columns
    error_rate_mean and error_rate_sd.
    """
    figure, ((axis,),) = new_figure(10.6, 4.6, grid="y")
    width = 0.84 / len(lines)
    at = np.arange(len(groups))
    wide = 100 * errors.set_index(["tested_on", "muscle", "line"])[["error_rate_mean", "error_rate_sd"]].unstack("line")
    means, spread = wide["error_rate_mean"], wide["error_rate_sd"].fillna(0.0)
    handles: list[Any] = []
    places = []
    for position, (line, (colour, hatch)) in enumerate(zip(lines, BARS, strict=False)):
        places.append(at + (position - (len(lines) - 1) / 2) * width)
        mean, sd = (found.loc["bank"].loc[list(groups), line] for found in (means, spread))
        bar = {"color": colour, "hatch": hatch, "edgecolor": INK, "linewidth": 0.6, "label": line}
        handles.append(axis.bar(places[-1], mean, width, yerr=sd, error_kw={"elinewidth": 0.9, "capsize": 2}, **bar))
    if "unseen_bank" in means.index:
        unseen = means.loc["unseen_bank"].loc[list(groups), list(lines)].to_numpy().T.ravel()
        mark = {"color": "white", "markeredgecolor": INK, "markersize": 4.5, "zorder": 3}
        handles += axis.plot(np.ravel(places), unseen, "D", label="tested on the unseen bank", **mark)
    axis.set_xticks(at, ["average of\nthe muscles" if name == AVERAGE else name for name in groups])
    axis.set(ylabel="error rate (%)", ylim=(0, None))
    axis.set_axisbelow(True)
    figure.legend(handles=handles, loc="outside upper center", ncols=3, frameon=False, fontsize=9)
    return figure


def begin_panels(count: int, width: float, height: float, **sharing: bool) -> tuple[Figure, Any]:
    """Return a figure and its panels, up to three abreast, or two by two, of so many inches each; some may be spare."""
    columns = 2 if count == 4 else min(3, count)
    rows = -(-count // columns)
    figure, axes = new_figure(width * columns, height * rows + 0.4, rows, columns, "both", sharex=True, **sharing)
    return figure, axes.ravel()


def finish_panels(figure: Figure, axes: Any, count: int, title: str | None = None) -> None:
    """Label the lowest panels' abscissa and put one legend above all panels."""
    for axis in axes[count:]:
        axis.axis("off")
    abreast = axes[0].get_gridspec().ncols
    for axis in axes[max(0, count - abreast) : count]:
        axis.set_xlabel("trial")
    handles, labels = axes[0].get_legend_handles_labels()
    names = [spell_arm(each) for each in labels]
    columns = min(4, len(labels))
    figure.legend(handles, names, title=title, frameon=False, loc="outside upper center", ncols=columns, fontsize=9)
