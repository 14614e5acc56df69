"""Points of a calibration, the line through them, and how far each lies from it."""

import numpy as np
import pandas as pd

from stages.science.figures.canvas import COLOURS, Figure, new_figure


def draw_channel_lines(points: pd.DataFrame, lines: pd.DataFrame) -> Figure:
    """Draw the channels of one kind: counts over known values above, residuals below.

    Points have columns channel, known and residual (in the channel's unit), count and problem; lines, one for each
    panel, have channel, unit, status, per_count, zero_count and sign.
    """
    width = max(2.9 * len(lines), 4.2)
    figure, (above, below) = new_figure(width, 4.6, 2, len(lines), "both", sharex="col", height_ratios=(2, 1))
    for top, bottom, line in zip(above, below, lines.to_dict("records"), strict=True):
        its = points[(points["channel"] == line["channel"]) & points["known"].notna() & points["count"].notna()]
        used = its[its["problem"] == ""]
        left_out = its[its["problem"] != ""]
        top.plot(used["known"], used["count"], "o", color=COLOURS[0], markersize=5, zorder=3)
        top.plot(left_out["known"], left_out["count"], "x", color=COLOURS[1], markersize=6, zorder=3)
        top.set_title(line["channel"] if line["status"] == "calibrated" else f"{line['channel']}: refused")
        if line["status"] == "calibrated":
            ends = np.array([min(0.0, its["known"].min()), its["known"].max()])
            line_counts = line["zero_count"] + ends / (line["sign"] * line["per_count"])
            top.plot(ends, line_counts, color="#9aa5b1", zorder=2)
            bottom.plot(used["known"], used["residual"], "o", color=COLOURS[0], markersize=5)
        bottom.axhline(0.0, color="#9aa5b1")
        bottom.set_xlabel(f"known ({line['unit']})")
    above[0].set_ylabel("count")
    below[0].set_ylabel(f"residual ({lines['unit'].iloc[0]})")
    return figure
