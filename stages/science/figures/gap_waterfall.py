"""The gap on verification trials, step by step: nominal, what each effect takes away, what is left, and the floor."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pandas as pd

from stages.science.figures.signal_words import AFTER, BEFORE, MEASURED, QUIET, spell

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FLOOR = "noise floor"


def draw_gap_waterfall(verification: pd.DataFrame) -> Figure:
    """Draw a panel for simulation from measured upstream signals and one for free run.

    Parameters
    ----------
    verification : DataFrame
        Columns simulation, step, label, gap, low and high, in order.
    """
    from matplotlib.figure import Figure

    kinds = list(dict.fromkeys(verification["simulation"]))
    figure = Figure(figsize=(10.6, 3.5), layout="constrained")
    panels = figure.subplots(1, len(kinds), sharey=True, squeeze=False)[0]
    for axis, kind in zip(panels, kinds, strict=True):
        _draw_falls(axis, verification[verification["simulation"] == kind])
        axis.set_title(
            f"simulated from {'measured upstream signals' if kind != 'free run' else 'the command alone (free run)'}",
            fontsize=10,
        )
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(axis="y", alpha=0.25)
    panels[0].set_ylabel("gap on verification trials (% of range)")
    panels[0].set_ylim(bottom=0.0)
    return figure


def _draw_falls(axis: Any, rows: pd.DataFrame) -> None:
    steps = rows[rows["label"] != FLOOR].reset_index(drop=True)
    gaps = 100.0 * steps["gap"]
    names, colours = ["nominal"], [BEFORE]
    bottoms, heights = [0.0], [float(gaps.iloc[0])]
    for before, after, name in zip(gaps[:-1], gaps[1:], steps["label"][1:], strict=True):
        names.append(spell(str(name)))
        bottoms.append(min(before, after))
        heights.append(abs(after - before))
        colours.append(QUIET)
    marked = steps.iloc[[0]]
    if len(steps) > 1:
        names.append("left")
        bottoms.append(0.0)
        heights.append(float(gaps.iloc[-1]))
        colours.append(AFTER)
        marked = steps.iloc[[0, -1]]
    places = list(range(len(names)))
    axis.bar(places, heights, bottom=bottoms, color=colours, width=0.6)
    for place, row in zip((0, places[-1]), marked.itertuples(index=False), strict=False):
        _mark(axis, place, row)
    floor = rows[rows["label"] == FLOOR]
    if len(floor):
        names.append(FLOOR)
        places.append(len(places))
        axis.bar(
            places[-1], 100.0 * float(floor["gap"].iloc[0]), color="white", edgecolor=MEASURED, hatch="//", width=0.6
        )
        _mark(axis, places[-1], next(floor.itertuples(index=False)))
        axis.axhline(100.0 * float(floor["gap"].iloc[0]), color=MEASURED, linewidth=0.9, linestyle=":")
    axis.set_xticks(
        places, names, rotation=20 if len(names) > 4 else 0, ha="right" if len(names) > 4 else "center", fontsize=9
    )


def _mark(axis: Any, place: int, row: Any) -> None:
    gap, low, high = (100.0 * float(each) for each in (row.gap, row.low, row.high))
    axis.errorbar(
        place, gap, yerr=[[max(gap - low, 0.0)], [max(high - gap, 0.0)]], fmt="none", ecolor=MEASURED, capsize=4
    )
    axis.annotate(f"{gap:.2g} %", (place, max(high, gap)), (0, 3), textcoords="offset points", ha="center", fontsize=9)
