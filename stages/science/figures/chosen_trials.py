"""What was chosen: the reference of each joint and the pressure commands of its muscles, trial after trial."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import pandas as pd

from stages.science.figures.canvas import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ANGLE_COLOUR, PRESSURE_COLOUR = "#c1272d", "#3b6fb6"


def draw_chosen_trials(
    chosen: pd.DataFrame, references: pd.DataFrame, muscles_of_joint: Mapping[str, Sequence[str]]
) -> Figure:
    """Draw references and pressure commands in the order of the trials.

    Parameters
    ----------
    chosen : DataFrame
        One row per trial, with columns trial and trajectory.
    references : DataFrame
        Columns trajectory, muscle, time_s, joint_angle_rad and pressure_command_kpa.
    muscles_of_joint : mapping of str to sequence of str
        Gives the panels and their order.
    """
    panels = []
    for joint, muscles in muscles_of_joint.items():
        panels.append((f"{joint}\nangle (rad)", muscles[0], "joint_angle_rad", ANGLE_COLOUR))
        panels += [(f"{name}\npressure (kPa)", name, "pressure_command_kpa", PRESSURE_COLOUR) for name in muscles]
    figure, axes = new_figure(11.0, 1.25 * len(panels) + 0.6, len(panels), sharex=True)
    times = references["time_s"].drop_duplicates().sort_values().to_numpy()
    duration_s = float(times[-1] + times[1] - times[0])
    for (axis,), (label, muscle, quantity, colour) in zip(axes, panels, strict=True):
        its = references[references["muscle"] == muscle]
        for position, trajectory in enumerate(chosen["trajectory"]):
            samples = its[its["trajectory"] == trajectory]
            axis.plot(samples["time_s"] + position * duration_s, samples[quantity], color=colour, linewidth=1.2)
            axis.axvline(position * duration_s, color="#dde3ea", linewidth=0.8, zorder=0)
        axis.set_ylabel(label, fontsize=9)
    axis.set(xlim=(0, len(chosen) * duration_s), xlabel=f"trial, {duration_s:g} s each")
    places = [(position + 0.5) * duration_s for position in range(len(chosen))]
    axis.set_xticks(places, [f"{row.trial}\nmovement {row.trajectory}" for row in chosen.itertuples()], fontsize=8)
    return figure
