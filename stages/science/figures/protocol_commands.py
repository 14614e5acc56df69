"""The automatic protocol: what each joint's muscles are commanded, trial after trial."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from stages.science.figures.canvas import new_figure
from stages.science.figures.learning_curves import COLOURS, STYLES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_POINTS = 100
"""Of a trial and muscle: enough for ramps, few to draw."""


def draw_protocol(commands: pd.DataFrame, muscles_of_joint: Mapping[str, Sequence[str]]) -> Figure:
    """Draw pressure commands in the order of the trials, one panel for each joint.

    Parameters
    ----------
    commands : DataFrame
        Columns trial, time_s, muscle and pressure_command_kpa, of one experiment.
    muscles_of_joint : mapping of str to sequence of str
        Gives the panels and their lines.
    """
    trials = list(commands["trial"].unique())
    times = commands["time_s"].drop_duplicates().sort_values().to_numpy()
    duration_s = float(times[-1] + times[1] - times[0])
    shown = times[:: -(-len(times) // MOST_POINTS)]
    at_s = np.add.outer(np.arange(len(trials)) * duration_s, [*shown, np.nan]).ravel()  # a gap after each trial
    figure, axes = new_figure(11.0, 2.1 * len(muscles_of_joint) + 0.6, len(muscles_of_joint), sharex=True)
    for (axis,), (joint, muscles) in zip(axes, muscles_of_joint.items(), strict=True):
        for position, muscle in enumerate(muscles):
            its = commands[commands["muscle"] == muscle]
            wide = its.pivot(index="trial", columns="time_s", values="pressure_command_kpa")
            commanded = np.pad(wide.loc[trials, shown].to_numpy(), ((0, 0), (0, 1))).ravel()
            colour, style = COLOURS[position % len(COLOURS)], STYLES[position % len(STYLES)]
            axis.plot(at_s, commanded, style, color=colour, linewidth=1.5, label=muscle)
        for position in range(1, len(trials)):
            axis.axvline(position * duration_s, color="#dde3ea", linewidth=0.8, zorder=0)
        axis.set_ylabel(f"{joint}\npressure command (kPa)")
        axis.set_ylim(bottom=0)
        axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    axis.set(xlim=(0, len(trials) * duration_s), xlabel=f"trial, {duration_s:g} s each")
    axis.set_xticks([(position + 0.5) * duration_s for position in range(len(trials))], [str(t) for t in trials])
    axis.tick_params(axis="x", length=0)
    return figure
