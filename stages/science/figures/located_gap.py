"""Where the gap lies: by channel, muscle and regime of motion, along signals, over the state plane; what is left."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from stages.science.figures.canvas import Figure, new_figure
from stages.science.figures.signal_words import (
    AFTER,
    BEFORE,
    MEASURED,
    STYLES,
    name_directions,
    name_panel,
    shorten,
)

LEFT_OUT = "everywhere"
NOTHING = 1.01
"""Gap over floor below which shares of the difference say nothing."""
ABREAST = 4
LEAST_SCALE = 1.0
COMPRESSED = ("command_rate",)
"""Signals whose steps are so large that the rest would not be seen on an even scale."""
TICKS = (-10000.0, -1000.0, -100.0, 0.0, 100.0, 1000.0, 10000.0)


def draw_gap_bars(channels: pd.DataFrame, smallest_gap: float) -> Figure:
    """Draw the gap of each channel of each muscle over its noise floor, with its upper limit.

    The frame has columns channel, muscle, unit, gap, noise_floor, gap_over_floor and upper. Below `smallest_gap` (over
    the floor) nothing is missing.
    """
    rows = channels.sort_values(["channel", "muscle"], ascending=[False, True]).reset_index(drop=True)
    figure, ((axis,),) = new_figure(10.6, 0.36 * len(rows) + 1.5, bare=True)
    place = range(len(rows))
    gaps = rows["gap_over_floor"]
    axis.barh(place, gaps, color=[BEFORE if gap > smallest_gap else AFTER for gap in gaps], height=0.62)
    above = (rows["upper"] - gaps).clip(lower=0.0)
    axis.errorbar(gaps, place, xerr=[0.0 * above, above], fmt="none", ecolor=MEASURED, capsize=3)
    axis.axvline(1.0, color=MEASURED, linewidth=1.0)
    told = f"smallest of interest, {smallest_gap:g}"
    axis.axvline(smallest_gap, color=MEASURED, linewidth=1.2, linestyle="--", label=told)
    ends = rows[["gap_over_floor", "upper"]].max(axis="columns").clip(lower=smallest_gap)
    for each, row in enumerate(rows.to_dict("records")):
        told = f"{row['gap']:.3g} {row['unit']}; floor {row['noise_floor']:.3g} {row['unit']}"
        axis.annotate(told, (ends[each], each), (6, 0), textcoords="offset points", va="center", fontsize=8)
    axis.set_yticks(place, [f"{shorten(row['channel'])}, {row['muscle']}" for row in rows.to_dict("records")])
    axis.invert_yaxis()
    axis.set_xlim(0.0, 1.25 * ends.max())
    axis.set_xlabel("gap over noise floor (1)")
    axis.legend(frameon=False, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.0)
    return figure


def draw_gap_map(gap: pd.DataFrame, channels: pd.DataFrame, level: float) -> Figure:
    """Draw each regime's share of the squared gap; a dot marks those that trials confirm after correction.

    A ring marks those that do so without it, at a level of significance. The gap has columns channel, muscle, regime,
    share_of_time, share_of_gap, p_value and p_adjusted; channels have channel, muscle and gap_over_floor.
    """
    named = list(dict.fromkeys(gap["channel"]))
    sizes = [gap.loc[gap["channel"] == each, "muscle"].nunique() for each in named]
    high = max(0.34 * sum(sizes), 1.4) + 1.75 * len(named)
    figure, panels = new_figure(10.6, high, len(named), gridspec_kw={"height_ratios": sizes})
    for axis, channel in zip(panels[:, 0], named, strict=True):
        over = channels[channels["channel"] == channel].set_index("muscle")["gap_over_floor"]
        rows = gap[(gap["channel"] == channel) & (gap["regime"] != LEFT_OUT)]
        regimes, muscles = list(dict.fromkeys(rows["regime"])), list(dict.fromkeys(rows["muscle"]))
        wide = rows.set_index(["muscle", "regime"])
        shares = wide["share_of_gap"].unstack()[regimes].loc[muscles].to_numpy(dtype=float)
        shown = 100.0 * np.clip(shares, 0.0, 1.0)
        image = axis.imshow(shown, cmap="Blues", vmin=0.0, vmax=100.0, aspect="auto")
        for row, muscle in enumerate(muscles):
            if over.get(muscle, 1.0) < NOTHING:
                axis.text(0.5 * (len(regimes) - 1), row, "no gap above the floor", ha="center", va="center", fontsize=8)
                continue
            for column, regime in enumerate(regimes):
                its = wide.loc[(muscle, regime)]
                mark = " \u25cf" if its["p_adjusted"] <= level else " \u25cb" if its["p_value"] <= level else ""
                tone = "white" if shown[row, column] > 55.0 else "#2b2b2b"
                told = f"{shown[row, column]:.0f}{mark}"
                axis.text(column, row, told, ha="center", va="center", color=tone, fontsize=8)
        axis.set_xticks(range(len(regimes)), regimes, rotation=35, ha="right", fontsize=8)
        axis.set_yticks(range(len(muscles)), [f"{each} ({over.get(each, np.nan):.2f})" for each in muscles])
        axis.set_title(f"{shorten(channel)}, by regime; in brackets the gap over the floor", loc="left", fontsize=10)
    figure.colorbar(image, ax=list(panels[:, 0]), shrink=0.8, pad=0.01, label="share of the squared gap (%)")
    return figure


def draw_residual_loops(loops: pd.DataFrame) -> Figure:
    """Draw the mean residual along a signal with two standard errors over trials, apart for the directions of motion.

    The frame has columns channel (a row of panels each), muscle (a panel each), unit, rate, direction, x, x_label, mean
    and error.
    """
    figure, panels = _lay_out(loops, 2.65, 0.6, 2.4)
    for axis, its, _, muscle in _fill(loops, panels):
        words = name_directions(its["rate"].iloc[0])
        for direction, line in its.groupby("direction", sort=False):
            colour, style = STYLES[str(direction)]
            told = words.get(str(direction), "measured")
            axis.plot(line["x"], line["mean"], color=colour, linestyle=style, linewidth=1.6, label=told)
            low, high = line["mean"] - 2 * line["error"], line["mean"] + 2 * line["error"]
            axis.fill_between(line["x"], low, high, color=colour, alpha=0.18, linewidth=0)
        axis.axhline(0.0, color=MEASURED, linewidth=0.8)
        name_panel(axis, muscle, its["x_label"].iloc[0])
    for axis, (named, unit) in zip(panels[:, 0], loops.groupby("channel", sort=False)["unit"], strict=True):
        axis.set_ylabel(f"{shorten(str(named))}, measured\nless simulated ({unit.iloc[0]})", fontsize=9)
        axis.legend(frameon=False, fontsize=8)
    return figure


def draw_residual_plane(plane: pd.DataFrame) -> Figure:
    """Draw the mean residual over the noise floor: over contraction and pressure, or over a command and its rate.

    The frame has columns channel (a row of panels each), muscle (a panel each), along, x, x_label, y, y_label and
    over_floor.
    """
    figure, panels = _lay_out(plane, 2.6, 1.4, 2.5)
    limit = max(LEAST_SCALE, float(np.quantile(plane["over_floor"].abs(), 0.98)))
    scale = {"cmap": "PuOr_r", "vmin": -limit, "vmax": limit}
    for axis, its, channel, muscle in _fill(plane, panels):
        dots = axis.scatter(its["x"], its["y"], c=its["over_floor"], s=11, marker="s", **scale)
        if its["along"].iloc[0] in COMPRESSED:
            low, high = its["y"].min(), its["y"].max()
            axis.set_yscale("asinh", linear_width=max(float(its["y"].abs().median()), 1.0))
            axis.set_yticks([each for each in TICKS if low <= each <= high], minor=False)
            axis.yaxis.set_major_formatter("{x:g}")
            axis.minorticks_off()
        name_panel(axis, f"{shorten(channel)}, {muscle}", its["x_label"].iloc[0])
        axis.set_ylabel(its["y_label"].iloc[0], fontsize=9)
        axis.set_facecolor("#eef1f4")
    told = "measured less simulated,\nover noise floor (1)"
    figure.colorbar(dots, ax=panels.ravel().tolist(), shrink=0.7, pad=0.01, label=told)
    return figure


def draw_unexplained(averages: pd.DataFrame) -> Figure:
    """Draw mean residuals as bars of two standard errors and the process as lines with bands, a panel for each cell.

    The frame has columns channel, muscle, unit, variable, beside, x, mean, error, said and deviation.
    """
    cells = list(averages.groupby(["channel", "muscle"], sort=False))
    columns, rows = min(len(cells), ABREAST), -(-len(cells) // ABREAST)
    figure, panels = new_figure(max(5.3, 2.65 * columns + 0.6), 3.1 * rows + 0.3, rows, columns)
    for axis in panels.flat[len(cells) :]:
        axis.axis("off")
    for place, (axis, (_, its)) in enumerate(zip(panels.flat, cells, strict=False)):
        for (beside, line), colour in zip(its.groupby("beside", sort=False), (BEFORE, AFTER), strict=False):
            bars = {"fmt": "o", "color": colour, "markersize": 3, "elinewidth": 0.9}
            axis.errorbar(line["x"], line["mean"], 2 * line["error"], **bars)
            axis.plot(line["x"], line["said"], color=colour, linewidth=1.6, label=str(beside) or None)
            low, high = line["said"] - 2 * line["deviation"], line["said"] + 2 * line["deviation"]
            axis.fill_between(line["x"], low, high, color=colour, alpha=0.18, linewidth=0)
        first = its.iloc[0]
        axis.axhline(0.0, color=MEASURED, linewidth=0.8)
        name_panel(axis, f"{first['muscle']}: {shorten(first['channel'])}", first["variable"])
        if place % ABREAST == 0:
            axis.set_ylabel(f"measured less simulated ({first['unit']})", fontsize=9)
        if first["beside"]:
            axis.legend(frameon=False, fontsize=7)
    return figure


def _lay_out(frame: pd.DataFrame, wide: float, more: float, high: float) -> tuple[Figure, Any]:
    """Return a figure with a row of panels for each channel and a panel for each muscle."""
    rows, columns = frame["channel"].nunique(), frame["muscle"].nunique()
    return new_figure(min(10.6, wide * columns + more), high * rows + 0.4, rows, columns)


def _fill(frame: pd.DataFrame, panels: Any) -> Iterator[tuple[Any, pd.DataFrame, str, str]]:
    """Yield each panel with its rows, its channel and its muscle; one without rows stays empty."""
    for row, channel in zip(panels, frame["channel"].unique(), strict=True):
        for axis, muscle in zip(row, frame["muscle"].unique(), strict=True):
            its = frame[(frame["channel"] == channel) & (frame["muscle"] == muscle)]
            if its.empty:
                axis.axis("off")
            else:
                yield axis, its, channel, muscle
