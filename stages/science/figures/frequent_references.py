"""The trajectories that were chosen most often: what each shows to the person and plays on the robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import pandas as pd

from stages.science.figures.learning_curves import COLOURS, STYLES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ANGLE_COLOUR = "#2b2b2b"


def draw_frequent_references(
    chosen: pd.DataFrame, references: pd.DataFrame, muscles_of_joint: Mapping[str, Sequence[str]]
) -> Figure:
    """Draw each joint's reference and its muscles' pressure commands, one column for each trajectory.

    Parameters
    ----------
    chosen : DataFrame
        A row for each column of panels: trajectory, share (of the experiments in which it was chosen) and experiments.
    references : DataFrame
        Columns trajectory, muscle, time_s, joint_angle_rad and pressure_command_kpa.
    muscles_of_joint : mapping of str to sequence of str
        Gives the rows of panels.
    """
    from matplotlib.figure import Figure

    heights = [1.0, 1.2] * len(muscles_of_joint)
    figure = Figure(figsize=(10.6, 1.45 * sum(heights) + 0.7), layout="constrained")
    axes = figure.subplots(len(heights), len(chosen), sharex=True, sharey="row", squeeze=False, height_ratios=heights)
    rows = zip(chosen["trajectory"], chosen["share"], chosen["experiments"], strict=True)
    for position, (trajectory, share, experiments) in enumerate(rows):
        its = references[references["trajectory"] == trajectory]
        axes[0, position].set_title(
            f"movement {trajectory}: {round(share * experiments)} of {experiments}", fontsize=11
        )
        for row, (joint, muscles) in enumerate(muscles_of_joint.items()):
            angle, pressure = axes[2 * row, position], axes[2 * row + 1, position]
            for line, muscle in enumerate(muscles):
                samples = its[its["muscle"] == muscle]
                if line == 0:
                    angle.plot(samples["time_s"], samples["joint_angle_rad"], color=ANGLE_COLOUR, linewidth=1.6)
                pressure.plot(
                    samples["time_s"],
                    samples["pressure_command_kpa"],
                    color=COLOURS[line % len(COLOURS)],
                    linestyle=STYLES[line % len(STYLES)],
                    linewidth=1.6,
                    label=muscle,
                )
            if position == 0:
                angle.set_ylabel(f"{joint}\nangle (rad)")
                pressure.set_ylabel(f"{joint}\npressure\ncommand (kPa)")
            if position == len(chosen) - 1:
                pressure.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
        axes[-1, position].set_xlabel("time (s)")
    for axis in axes.ravel():
        axis.grid(alpha=0.25)
    for axis in axes[1::2, 0]:
        axis.set_ylim(bottom=0)
    axes[0, 0].set_xlim(left=0)
    return figure
