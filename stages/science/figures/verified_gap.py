"""What effects close of the gap: candidates, signatures of named ones, the gap step by step, verification trials."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from textwrap import fill
from typing import Any

import pandas as pd

from stages.science.figures.canvas import Figure, new_figure
from stages.science.figures.signal_words import (
    AFTER,
    BEFORE,
    LEARNED,
    MEASURED,
    QUIET,
    STYLES,
    name_directions,
    name_panel,
    shorten,
    spell,
)
from stages.science.recording.signal_names import label, name_signal

LETTERS_PER_INCH = 12
FLOOR, MAP = "noise floor", "+ learned map"
SIMULATED = {
    "before": (BEFORE, "--", "simulated before"),
    "after": (AFTER, "-", "simulated after"),
    "patched": (LEARNED, "-", "with a learned map too"),
}
LEAST_PROBABILITY = 0.005


def draw_candidate_ranking(ranking: pd.DataFrame) -> Figure:
    """Draw probabilities as bars, and held-out gaps as points beside the gap that there is, most probable ones first.

    A ranking of one round has columns name, probability, heldout_gap and absorbed; candidates that say nothing are left
    out.
    """
    always = ranking["name"].isin(["none", "unknown"])
    now = float(ranking.loc[ranking["name"] == "none", "heldout_gap"].iloc[0])
    tells = (ranking["probability"] >= LEAST_PROBABILITY) | (ranking["heldout_gap"] < now) | ranking["absorbed"]
    order = ["absorbed", "probability", "heldout_gap"]
    rows = ranking[always | tells].sort_values(order, ascending=[True, False, True]).reset_index(drop=True)
    sharing = {"sharey": True, "width_ratios": [1.0, 1.1]}
    figure, ((left, right),) = new_figure(10.6, 0.27 * len(rows) + 1.1, 1, 2, "x", bare=True, **sharing)
    place = range(len(rows))
    left.barh(place, rows["probability"], color=[BEFORE if each == 0 else AFTER for each in place], height=0.66)
    for each, row in enumerate(rows.to_dict("records")):
        p = float(row["probability"])
        told = "absorbed" if row["absorbed"] else "> 0.99" if p > 0.995 else "< 0.01" if p < 0.005 else f"{p:.2f}"
        left.annotate(told, (p, each), (4, 0), textcoords="offset points", va="center", fontsize=8)
    left.set_yticks(place, [spell(each) for each in rows["name"]])
    left.invert_yaxis()
    left.set(xlim=(0.0, 1.18), xlabel="probability (1)", xticks=[0.0, 0.25, 0.5, 0.75, 1.0])
    right.axvline(100.0 * now, color=MEASURED, linestyle="--", linewidth=1.0, label="as it is")
    right.legend(frameon=False, fontsize=8, loc="lower left")
    closed = ~rows["absorbed"]
    right.plot(100.0 * rows["heldout_gap"][closed], rows.index[closed], "o", color=AFTER)
    right.plot(100.0 * rows["heldout_gap"][~closed], rows.index[~closed], "o", color=QUIET, fillstyle="none")
    right.set(xlim=(0.0, 105.0 * rows["heldout_gap"].max()), xlabel="gap with it, trials left out (% of range)")
    return figure


def draw_effect_signature(traced: pd.DataFrame, signature: str) -> Figure:
    """Draw what a named effect adds to the simulation over the residual without it, a panel for each muscle.

    `traced`, of one effect, has columns effect, channel, muscle, unit, rate, direction, x, x_label, measured (drawn
    with two standard errors), error and added; the signature says in one sentence what it leaves in the residual.
    """
    muscles = list(traced["muscle"].unique())
    first = traced.iloc[0]
    figure, (panels,) = new_figure(max(5.3, min(10.6, 2.65 * len(muscles) + 0.6)), 3.6, 1, len(muscles))
    names = name_directions(first["rate"])
    for axis, muscle in zip(panels, muscles, strict=True):
        for direction, its in traced[traced["muscle"] == muscle].groupby("direction", sort=False):
            colour, style = STYLES[str(direction)]
            way = f", {names[str(direction)]}" if direction in names else ""
            bars = {"fmt": "o", "color": colour, "markersize": 4, "elinewidth": 0.9}
            axis.errorbar(its["x"], its["measured"], 2 * its["error"], **bars, label=f"measured{way}")
            told = f"{spell(first['effect'])}{way}"
            axis.plot(its["x"], its["added"], color=colour, linestyle=style, linewidth=1.8, label=told)
        axis.axhline(0.0, color=MEASURED, linewidth=0.8)
        name_panel(axis, muscle, first["x_label"])
    what = f"{shorten(first['channel'])} without it:\nmeasured less simulated ({first['unit']})"
    panels[0].set_ylabel(what, fontsize=9)
    handles = panels[0].get_legend_handles_labels()
    figure.legend(*handles, loc="outside lower center", ncols=4 if len(panels) > 1 else 2, frameon=False, fontsize=8)
    title = f"{spell(first['effect'])}: {signature}"
    figure.suptitle(fill(title, round(LETTERS_PER_INCH * figure.get_figwidth())), fontsize=10)
    return figure


def draw_gap_waterfall(verification: pd.DataFrame) -> Figure:
    """Draw the gap on verification trials: nominal, what each effect takes away, what is left, and the floor.

    The frame has columns simulation (a panel each), step, label, gap, low and high, in order.
    """
    kinds = list(verification["simulation"].unique())
    figure, (panels,) = new_figure(10.6, 3.5, 1, len(kinds), "y", bare=True, sharey=True)
    for axis, kind in zip(panels, kinds, strict=True):
        _draw_falls(axis, verification[verification["simulation"] == kind])
        source = "the command alone (free run)" if kind == "free run" else "measured upstream signals"
        axis.set_title(f"simulated from {source}", fontsize=10)
    panels[0].set_ylabel("gap on verification trials (% of range)")
    panels[0].set_ylim(bottom=0.0)
    return figure


def _draw_falls(axis: Any, rows: pd.DataFrame) -> None:
    """Draw a bar from 0 for the first and the last gap, and what lies between two gaps for each step."""
    steps: list[Any] = [*rows[rows["label"] != FLOOR].itertuples(index=False)]
    first, last = steps[0], steps[-1]
    bars: list[tuple[str, float, float, str, Any]] = [("nominal", 0.0, first.gap, BEFORE, first)]
    bars += [
        (spell(str(after.label)), before.gap, after.gap, LEARNED if after.label == MAP else QUIET, None)
        for before, after in pairwise(steps)
    ]
    if len(steps) > 1:
        bars.append(("left", 0.0, last.gap, AFTER, last))
    for place, (_, one, other, colour, marked) in enumerate(bars):
        low, high = sorted((100.0 * one, 100.0 * other))
        axis.bar(place, high - low, bottom=low, color=colour, width=0.6)
        if marked is not None:
            _mark(axis, place, marked)
    names = [bar[0] for bar in bars]
    floors: list[Any] = [*rows[rows["label"] == FLOOR].head(1).itertuples(index=False)]
    for floor in floors:
        axis.bar(len(names), 100.0 * floor.gap, color="white", edgecolor=MEASURED, hatch="//", width=0.6)
        _mark(axis, len(names), floor)
        axis.axhline(100.0 * floor.gap, color=MEASURED, linewidth=0.9, linestyle=":")
        names.append(FLOOR)
    turned = {"rotation": 20, "ha": "right"} if len(names) > 4 else {"rotation": 0, "ha": "center"}
    axis.set_xticks(range(len(names)), names, fontsize=9, **turned)


def _mark(axis: Any, place: int, row: Any) -> None:
    gap, low, high = (100.0 * float(each) for each in (row.gap, row.low, row.high))
    ends = [[max(gap - low, 0.0)], [max(high - gap, 0.0)]]
    axis.errorbar(place, gap, yerr=ends, fmt="none", ecolor=MEASURED, capsize=4)
    axis.annotate(f"{gap:.2g} %", (place, max(high, gap)), (0, 3), textcoords="offset points", ha="center", fontsize=9)


def draw_verified_trials(
    predictions: pd.DataFrame, channel: str, muscles: Sequence[str], trials: Mapping[int, str]
) -> Figure:
    """Draw the first muscle's channel in each trial, a column each, and below it each muscle's residuals, a row each.

    Predictions have columns trial, time_s, muscle, channel, measured, before, after, patched, low and high; the trials
    have what they are called.
    """
    told = ["before", *(new for old, new in pairwise(SIMULATED) if not predictions[new].equals(predictions[old]))]
    heights = [1.4, *(1.0 for _ in muscles)]
    sharing: dict[str, Any] = {"sharex": "col", "sharey": "row", "gridspec_kw": {"height_ratios": heights}}
    figure, panels = new_figure(10.6, 2.1 + 1.45 * len(muscles), len(heights), len(trials), **sharing)
    for column, (trial, title) in enumerate(trials.items()):
        rows = predictions[(predictions["channel"] == channel) & (predictions["trial"] == trial)]
        top, first = panels[0, column], rows[rows["muscle"] == muscles[0]]
        top.plot(first["time_s"], first["measured"], color=QUIET, linewidth=3.0, label="measured")
        for name in told:
            colour, style, words = SIMULATED[name]
            words = words if len(told) > 1 else "simulated"
            top.plot(first["time_s"], first[name], style, color=colour, linewidth=1.1, label=words)
        top.set_title(f"trial {title}", fontsize=10)
        for axis, muscle in zip(panels[1:, column], muscles, strict=True):
            line = rows[rows["muscle"] == muscle]
            axis.axhline(0.0, color=MEASURED, linewidth=0.8)
            ends = (line[end] - line["patched"] for end in ("low", "high"))
            band = f"band about {'the last' if len(told) > 1 else 'it'}"
            axis.fill_between(line["time_s"], *ends, color=QUIET, alpha=0.35, linewidth=0.0, label=band)
            for name in told:
                axis.plot(line["time_s"], line["measured"] - line[name], color=SIMULATED[name][0], linewidth=0.9)
        panels[-1, column].set_xlabel("time (s)", fontsize=9)
    panels[0, 0].set_ylabel(f"{muscles[0]}\n{label(channel)}", fontsize=9)
    for axis, muscle in zip(panels[1:, 0], muscles, strict=True):
        axis.set_ylabel(f"{muscle}\n{label('residual', name_signal(channel)[1])}", fontsize=9)
    figure.align_ylabels(panels[:, 0])
    lines, areas = (panels[row, 0].get_legend_handles_labels() for row in (0, 1))
    handles = [*lines[0], *areas[0]], [*lines[1], *areas[1]]
    figure.legend(*handles, loc="outside upper center", ncols=5, frameon=False, fontsize=9)
    for axis in panels.ravel():
        axis.tick_params(labelsize=8)
        axis.grid(alpha=0.2)
    return figure
