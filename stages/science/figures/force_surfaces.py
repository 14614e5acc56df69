"""A learned force over two inputs, and beside it how sure the model is of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LABELS = {
    "pressure_kpa": "pressure (kPa)",
    "contraction": "contraction (1)",
    "contraction_velocity_per_s": "contraction velocity (1/s)",
}
PANELS = (("mean_n", "force (N)", "viridis"), ("sd_n", "standard deviation (N)", "magma"))
LEVELS = 12


def draw_force_surfaces(
    surfaces: pd.DataFrame, points: pd.DataFrame, sections: Mapping[str, tuple[str, str]], near: float
) -> Figure:
    """Draw mean and standard deviation as filled contours, one row for each section.

    Parameters
    ----------
    surfaces : DataFrame
        Columns section, those of the inputs, mean_n, sd_n and nearest (distance to the nearest sample of the bank), on
        a regular grid, of one muscle.
    points : DataFrame
        Columns of the inputs and trial: what the model stands on.
    sections : mapping of str to (str, str)
        Columns of the inputs that vary, horizontally and vertically.
    near : float
        Distance beyond which a state is hatched.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.6, 4.0 * len(sections) + 0.4), layout="constrained")
    axes = figure.subplots(len(sections), len(PANELS), squeeze=False)
    for row, (section, (across, up)) in zip(axes, sections.items(), strict=True):
        its = surfaces[surfaces["section"] == section]
        tables = {name: its.pivot(index=up, columns=across, values=name) for name in ("mean_n", "sd_n", "nearest")}
        at: tuple[Any, Any] = (tables["nearest"].columns.to_numpy(), tables["nearest"].index.to_numpy())
        far = tables["nearest"].to_numpy()
        for axis, (name, label, colours) in zip(row, PANELS, strict=True):
            filled = axis.contourf(*at, tables[name].to_numpy(), levels=LEVELS, cmap=colours)
            figure.colorbar(filled, ax=axis, label=label)
            if far.max() > near:
                axis.contourf(*at, far, levels=[near, np.inf], colors="white", alpha=0.4, hatches=["///"])
                axis.contour(*at, far, levels=[near], colors="white", linewidths=1.2)
            for chosen, marker, told in ((False, "o", "of the initial data"), (True, "^", "of designed trials")):
                known = points[(points["trial"] > 0) == chosen]
                style = {"markerfacecolor": "white", "markeredgecolor": "black", "markersize": 6, "linestyle": "none"}
                axis.plot(known[across], known[up], marker=marker, label=told, **style)
            axis.set(xlabel=LABELS[across], ylabel=LABELS[up])
            axis.set_xlim(at[0][0], at[0][-1])
            axis.set_ylim(at[1][0], at[1][-1])
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, title="points", loc="outside upper center", ncols=2, frameon=False)
    return figure
