"""The trial that would tell rival names apart: what drives the machine, and how rivals' predictions differ."""

from collections.abc import Sequence

import pandas as pd

from stages.science.figures.canvas import COLOURS, LINES, Figure, new_figure
from stages.science.figures.signal_words import MEASURED, QUIET, spell
from stages.science.recording.signal_names import label, name_signal


def draw_proposed_trial(signals: pd.DataFrame, rivals: Sequence[str]) -> Figure:
    """Draw what drives the machine, a panel each; what the first rival predicts, and by how much others differ from it.

    Signals have columns muscle, channel, time_s, signal and value; of these signals the rivals are predictions.
    """
    wide = signals.pivot(index="time_s", columns="signal", values="value")
    where, channel = (str(signals[name].iloc[0]) for name in ("muscle", "channel"))
    levers = [each for each in signals["signal"].unique() if each not in rivals]
    names = ["no further effect" if each == "none" else spell(each) for each in rivals]
    heights = {"gridspec_kw": {"height_ratios": [*(1.0 for _ in levers), 1.3, 1.7]}}
    high = 1.1 * len(levers) + 3.6
    figure, panels = new_figure(8.0, high, len(levers) + 2, 1, "both", bare=True, sharex=True, **heights)
    *drives, first, last = panels[:, 0]
    for axis, name in zip(drives, levers, strict=True):
        axis.plot(wide.index, wide[name], color=MEASURED)
        axis.set_ylabel(label(name), fontsize=8)
    first.plot(wide.index, wide[rivals[0]], color=QUIET, label=f"by {names[0]}")
    first.set_ylabel(f"{where}\n{label(channel)}", fontsize=8)
    for place, (rival, name) in enumerate(zip(rivals[1:], names[1:], strict=True)):
        style = {"color": COLOURS[place % len(COLOURS)], "linestyle": LINES[place % len(LINES)]}
        last.plot(wide.index, wide[rival] - wide[rivals[0]], **style, label=f"by {name} less by {names[0]}")
    last.axhline(0.0, color=MEASURED, linewidth=0.8)
    last.set_ylabel(f"{where}\n{label('difference', name_signal(channel)[1])}", fontsize=8)
    last.set_xlabel("time (s)", fontsize=9)
    figure.suptitle(f"a trial that would tell apart: {', '.join(names)}", fontsize=10)
    figure.align_ylabels()
    for axis in (first, last):
        axis.legend(frameon=False, fontsize=8)
    for axis in panels[:, 0]:
        axis.tick_params(labelsize=8)
    return figure
