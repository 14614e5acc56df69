"""The trial that would tell rival names apart: what drives the machine, and what each rival predicts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import pandas as pd

from stages.science.figures.canvas import COLOURS, LINES, new_figure
from stages.science.figures.signal_words import MEASURED, label, spell

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_proposed_trial(signals: pd.DataFrame, rivals: Sequence[str]) -> Figure:
    """Draw what drives the machine, a panel each, and below what the rivals predict of one channel.

    Signals have columns muscle, channel, time_s, signal and value; of these signals the rivals are predictions.
    """
    first = signals.iloc[0]
    levers = [each for each in signals["signal"].unique() if each not in rivals]
    heights = {"gridspec_kw": {"height_ratios": [*(1.0 for _ in levers), 2.0]}}
    figure, panels = new_figure(8.0, 1.2 * len(levers) + 2.8, len(levers) + 1, 1, sharex=True, **heights)
    for axis, name in zip(panels[:, 0], levers, strict=False):
        its = signals[signals["signal"] == name]
        axis.plot(its["time_s"], its["value"], color=MEASURED)
        axis.set_ylabel(label(name), fontsize=8)
    last = panels[-1, 0]
    for place, name in enumerate(rivals):
        its = signals[signals["signal"] == name]
        told = "nothing missing" if name == "none" else spell(name)
        last.plot(
            its["time_s"], its["value"], LINES[place % len(LINES)], color=COLOURS[place % len(COLOURS)], label=told
        )
    last.set_ylabel(f"{first['muscle']}\n{label(first['channel'])}", fontsize=9)
    last.set_xlabel("time (s)", fontsize=9)
    last.legend(frameon=False, fontsize=9)
    for axis in panels[:, 0]:
        axis.grid(alpha=0.25)
        axis.spines[["top", "right"]].set_visible(False)
    return figure
