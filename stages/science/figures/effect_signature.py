"""The signature of a named effect: what it adds to the simulation, over the residual that is left without it."""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING

import pandas as pd

from stages.science.figures.residual_loops import DIRECTIONS, STYLES
from stages.science.figures.signal_words import MEASURED, label, shorten, spell

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LETTERS_PER_INCH = 12


def draw_effect_signature(traced: pd.DataFrame, signature: str) -> Figure:
    """Draw measured residuals as bars of two standard errors and the effect as lines, a panel for each muscle.

    Parameters
    ----------
    traced : DataFrame
        Of one effect: columns effect, channel, muscle, unit, variable, direction, x, measured, error and added.
    signature : str
        What the effect leaves in the residual, in one sentence.
    """
    from matplotlib.figure import Figure

    muscles = list(dict.fromkeys(traced["muscle"]))
    first = traced.iloc[0]
    figure = Figure(figsize=(max(5.3, min(10.6, 2.65 * len(muscles) + 0.6)), 3.6), layout="constrained")
    panels = figure.subplots(1, len(muscles), squeeze=False)[0]
    names = dict(zip(("rising", "falling"), DIRECTIONS.get(first["channel"], ("rising", "falling")), strict=True))
    for axis, muscle in zip(panels, muscles, strict=True):
        for direction, its in traced[traced["muscle"] == muscle].groupby("direction", sort=False):
            colour, style = STYLES[str(direction)]
            way = f", {names[str(direction)]}" if str(direction) in names else ""
            axis.errorbar(
                its["x"],
                its["measured"],
                2 * its["error"],
                fmt="o",
                color=colour,
                markersize=4,
                elinewidth=0.9,
                label=f"measured{way}",
            )
            axis.plot(
                its["x"],
                its["added"],
                color=colour,
                linestyle=style,
                linewidth=1.8,
                label=f"{spell(first['effect'])}{way}",
            )
        axis.axhline(0.0, color=MEASURED, linewidth=0.8)
        axis.set_title(muscle, fontsize=10)
        axis.set_xlabel(label(first["variable"], first["channel"], first["unit"]), fontsize=9)
        axis.tick_params(labelsize=8)
    panels[0].set_ylabel(
        f"{shorten(first['channel'])} without it:\nmeasured less simulated ({first['unit']})", fontsize=9
    )
    abreast = 4 if len(panels) > 1 else 2
    handles = panels[0].get_legend_handles_labels()
    figure.legend(*handles, loc="outside lower center", ncols=abreast, frameon=False, fontsize=8)
    title = f"{spell(first['effect'])}: {signature}"
    figure.suptitle(fill(title, round(LETTERS_PER_INCH * figure.get_figwidth())), fontsize=10)
    return figure
