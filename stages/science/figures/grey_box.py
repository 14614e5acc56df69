"""Error rates of plants and of models on them, rung by rung."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from stages.science.figures.canvas import COLOURS, Figure, new_figure
from stages.science.figures.learning_curves import AVERAGE, INK, MARKERS, TITLES

LABELS = {"gaussian_process": "Gaussian_process"}


def draw_rungs(errors: pd.DataFrame, rungs: Sequence[str], panels: Sequence[str]) -> Figure:
    """Draw the error rate over rungs, a panel for each test set: a line for each muscle, and for their average.

    Columns are participant, experiment, tested_on, muscle, rung and error_rate; lines are means over experiments, each
    of which is a point where there are several.
    """
    from matplotlib.ticker import LogLocator

    figure, (axes,) = new_figure(4.9 * len(panels) + 0.5, 4.2, 1, len(panels), "y", sharey=True)
    at = np.arange(len(rungs))
    muscles = [name for name in errors["muscle"].unique() if name != AVERAGE]
    several = errors.groupby(["participant", "experiment"]).ngroups > 1
    for axis, panel in zip(axes, panels, strict=True):
        its = errors[errors["tested_on"] == panel]
        for position, muscle in enumerate([*muscles, AVERAGE]):
            own = its[its["muscle"] == muscle]
            mean = 100 * own.groupby("rung")["error_rate"].mean().loc[list(rungs)]
            last = muscle == AVERAGE
            colour, label = (INK, "average of the muscles") if last else (COLOURS[position % len(COLOURS)], muscle)
            style = {"color": colour, "marker": MARKERS[position % len(MARKERS)], "linewidth": 2.6 if last else 1.2}
            axis.plot(at, mean, label=label, **style)
            if several:
                places = own["rung"].map({name: place for place, name in enumerate(rungs)})
                axis.plot(places, 100 * own["error_rate"], ".", color=colour, alpha=0.4, markersize=4)
            if last:
                for place, value in zip(at, mean, strict=True):
                    how: dict[str, Any] = {"ha": "left", "va": "bottom", "fontsize": 9, "fontweight": "bold"}
                    how["bbox"] = {"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 1.0}
                    axis.annotate(f"{value:.2g} %", (place, value), (6, 4), textcoords="offset points", **how)
        axis.set_yscale("log")
        axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_formatter("")
        axis.set_xticks(at, [LABELS.get(name, name).replace("_", "\n") for name in rungs])
        axis.set(title=TITLES[panel], xlim=(-0.3, len(rungs) - 0.45))
    axes[0].set_ylabel("error rate (%)")
    axes[0].legend(frameon=False, fontsize=9)
    return figure
