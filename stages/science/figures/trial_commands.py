"""What muscles are commanded, trial after trial: of chosen trials beside their references, and of a protocol."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from stages.science.figures.canvas import COLOURS, LINES, Figure, new_figure

ANGLE_COLOUR, PRESSURE_COLOUR = "#c1272d", "#3b6fb6"
MOST_POINTS = 100
"""Of a trial and muscle of a protocol: enough for ramps, few to draw."""


def draw_chosen_trials(
    chosen: pd.DataFrame, commands: pd.DataFrame, muscles_of_joint: Mapping[str, Sequence[str]]
) -> Figure:
    """Draw references and pressure commands in the order of the trials, in panels for each joint and its muscles.

    `chosen` has a row per trial with columns trial and trajectory; commands have trial, muscle, time_s,
    joint_angle_rad and pressure_command_kpa.
    """
    panels = []
    for joint, muscles in muscles_of_joint.items():
        panels.append((f"{joint}\nangle (rad)", muscles[0], "joint_angle_rad", ANGLE_COLOUR))
        panels += [(f"{name}\npressure (kPa)", name, "pressure_command_kpa", PRESSURE_COLOUR) for name in muscles]
    figure, axes = new_figure(11.0, 1.25 * len(panels) + 0.6, len(panels), sharex=True)
    _, duration_s = _read_times(commands)
    for (axis,), (label, muscle, quantity, colour) in zip(axes, panels, strict=True):
        its = commands[commands["muscle"] == muscle]
        for position, trial in enumerate(chosen["trial"]):
            samples = its[its["trial"] == trial]
            axis.plot(samples["time_s"] + position * duration_s, samples[quantity], color=colour, linewidth=1.2)
            axis.axvline(position * duration_s, color="#dde3ea", linewidth=0.8, zorder=0)
        axis.set_ylabel(label, fontsize=9)
    names = [f"{row.trial}\nmovement {row.trajectory}" for row in chosen.itertuples()]
    _name_trials(axis, duration_s, names, fontsize=8)
    return figure


def draw_protocol(commands: pd.DataFrame, muscles_of_joint: Mapping[str, Sequence[str]]) -> Figure:
    """Draw one experiment's commands (trial, time_s, muscle, pressure_command_kpa), one panel for each joint."""
    trials = list(commands["trial"].unique())
    times, duration_s = _read_times(commands)
    shown = times[:: -(-len(times) // MOST_POINTS)]
    at_s = np.add.outer(np.arange(len(trials)) * duration_s, [*shown, np.nan]).ravel()  # a gap after each trial
    figure, axes = new_figure(11.0, 2.1 * len(muscles_of_joint) + 0.6, len(muscles_of_joint), sharex=True)
    for (axis,), (joint, muscles) in zip(axes, muscles_of_joint.items(), strict=True):
        for position, muscle in enumerate(muscles):
            its = commands[commands["muscle"] == muscle]
            wide = its.pivot(index="trial", columns="time_s", values="pressure_command_kpa")
            commanded = np.pad(wide.loc[trials, shown].to_numpy(), ((0, 0), (0, 1))).ravel()
            colour, style = COLOURS[position % len(COLOURS)], LINES[position % len(LINES)]
            axis.plot(at_s, commanded, style, color=colour, linewidth=1.5, label=muscle)
        for position in range(1, len(trials)):
            axis.axvline(position * duration_s, color="#dde3ea", linewidth=0.8, zorder=0)
        axis.set_ylabel(f"{joint}\npressure command (kPa)")
        axis.set_ylim(bottom=0)
        axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    _name_trials(axis, duration_s, [str(each) for each in trials])
    axis.tick_params(axis="x", length=0)
    return figure


def _read_times(frame: pd.DataFrame) -> tuple[np.ndarray, float]:
    """Return the times within a trial and its duration, s."""
    times = frame["time_s"].drop_duplicates().sort_values().to_numpy()
    return times, float(times[-1] + times[1] - times[0])


def _name_trials(axis: Any, duration_s: float, names: Sequence[str], **how: Any) -> None:
    axis.set(xlim=(0, len(names) * duration_s), xlabel=f"trial, {duration_s:g} s each")
    axis.set_xticks([(position + 0.5) * duration_s for position in range(len(names))], names, **how)
