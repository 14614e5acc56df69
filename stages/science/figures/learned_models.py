"""What learned models say: forces over their inputs, the trajectories chosen most often, coverage of intervals."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from stages.science.figures.canvas import COLOURS, LINES, Figure, new_figure
from stages.science.figures.learning_curves import AVERAGE, begin_panels, finish_panels

LABELS = {
    "pressure_kpa": "pressure (kPa)",
    "contraction": "contraction (1)",
    "contraction_velocity_per_s": "contraction velocity (1/s)",
}
PANELS = (("mean_n", "force (N)", "viridis"), ("sd_n", "standard deviation (N)", "magma"))
LEVELS = 12
ANGLE_COLOUR = "#2b2b2b"
MODELS = (("plain", "#3b6fb6", "s"), ("marginal", "#c1272d", "o"))
TESTS = {"bank": ("-", "the bank"), "unseen_bank": ("--", "an unseen bank")}
NOMINAL_PERCENT = 95


def draw_force_surfaces(
    surfaces: pd.DataFrame, points: pd.DataFrame, sections: Mapping[str, tuple[str, str]], near: float
) -> Figure:
    """Draw a learned force over two inputs and its standard deviation as filled contours, one row for each section.

    A section names the columns of the inputs that vary horizontally and vertically. Surfaces, on a regular grid, of one
    muscle, have columns section, those of the inputs, mean_n, sd_n and nearest (distance to the nearest sample of the
    bank; states beyond `near` are hatched); the points that the model stands on have those of the inputs and trial.
    """
    figure, axes = new_figure(10.6, 4.0 * len(sections) + 0.4, len(sections), len(PANELS))
    style = {"markerfacecolor": "white", "markeredgecolor": "black", "markersize": 6, "linestyle": "none"}
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
                axis.plot(known[across], known[up], marker=marker, label=told, **style)
            axis.set(xlabel=LABELS[across], ylabel=LABELS[up])
            axis.set(xlim=(at[0][0], at[0][-1]), ylim=(at[1][0], at[1][-1]))
    handles = axes[0, 0].get_legend_handles_labels()
    figure.legend(*handles, title="points", loc="outside upper center", ncols=2, frameon=False)
    return figure


def draw_frequent_references(
    chosen: pd.DataFrame, references: pd.DataFrame, muscles_of_joint: Mapping[str, Sequence[str]]
) -> Figure:
    """Draw the trajectories chosen most often: each joint's reference and its muscles' pressure commands.

    `chosen` has a row for each column of panels: trajectory, share (of the experiments in which it was chosen) and
    experiments; references have trajectory, muscle, time_s, joint_angle_rad and pressure_command_kpa.
    """
    heights = [1.0, 1.2] * len(muscles_of_joint)
    sharing: dict[str, Any] = {"sharex": True, "sharey": "row", "height_ratios": heights}
    figure, axes = new_figure(10.6, 1.45 * sum(heights) + 0.7, len(heights), len(chosen), "both", **sharing)
    for position, movement in enumerate(chosen.to_dict("records")):
        its = references[references["trajectory"] == movement["trajectory"]]
        often = f"{round(movement['share'] * movement['experiments'])} of {movement['experiments']}"
        axes[0, position].set_title(f"movement {movement['trajectory']}: {often}", fontsize=11)
        for row, (joint, muscles) in enumerate(muscles_of_joint.items()):
            angle, pressure = axes[2 * row, position], axes[2 * row + 1, position]
            for line, muscle in enumerate(muscles):
                samples = its[its["muscle"] == muscle]
                if line == 0:
                    angle.plot(samples["time_s"], samples["joint_angle_rad"], color=ANGLE_COLOUR, linewidth=1.6)
                colour, style = COLOURS[line % len(COLOURS)], LINES[line % len(LINES)]
                commands = samples["pressure_command_kpa"]
                pressure.plot(samples["time_s"], commands, style, color=colour, linewidth=1.6, label=muscle)
            if position == 0:
                angle.set_ylabel(f"{joint}\nangle (rad)")
                pressure.set_ylabel(f"{joint}\npressure\ncommand (kPa)")
            if position == len(chosen) - 1:
                pressure.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
        axes[-1, position].set_xlabel("time (s)")
    for axis in axes[1::2, 0]:
        axis.set_ylim(bottom=0)
    axes[0, 0].set_xlim(left=0)
    return figure


def draw_reliability(reliability: pd.DataFrame, panels: Sequence[str]) -> Figure:
    """Draw the share of measured forces within each model's 95 % intervals, with its own interval over experiments.

    Columns are tested_on, muscle (of which those of `panels` have one each), trial and, of each model, plain_share,
    plain_low, plain_high and so on.
    """
    figure, axes = begin_panels(len(panels), 3.53, 2.9, sharey=True)
    lines = [(test, *model) for test in reliability["tested_on"].unique() for model in MODELS]
    trials = np.sort(reliability["trial"].unique())
    step = 0.02 * max(1, np.ptp(trials))
    for axis, muscle in zip(axes, panels, strict=False):
        axis.axhline(NOMINAL_PERCENT, color="#2b2b2b", linewidth=1.0, linestyle=":", label=f"{NOMINAL_PERCENT} %")
        for position, (test, model, colour, marker) in enumerate(lines):
            chosen = (reliability["tested_on"] == test) & (reliability["muscle"] == muscle)
            its = reliability[chosen].sort_values("trial")
            share = its[f"{model}_share"]
            ends = [(share - its[f"{model}_low"]).fillna(0.0), (its[f"{model}_high"] - share).fillna(0.0)]
            style, described = TESTS[test]
            bars: dict[str, Any] = {"markersize": 5, "linewidth": 1.4, "elinewidth": 0.9, "capsize": 2}
            bars |= {"color": colour, "marker": marker, "linestyle": style, "label": f"{model}, {described}"}
            bars["markerfacecolor"] = colour if style == "-" else "white"
            trial = its["trial"] + step * (position - (len(lines) - 1) / 2)
            axis.errorbar(trial, 100 * share, 100 * np.array(ends), **bars)
        axis.set(title="average of the muscles" if muscle == AVERAGE else muscle)
        axis.set_xticks(trials)
        axis.tick_params(labelbottom=True, labelleft=True)
    for axis in axes[:: axes[0].get_gridspec().ncols]:
        axis.set_ylabel("forces within\n95 % intervals (%)")
    finish_panels(figure, axes, len(panels))
    return figure
