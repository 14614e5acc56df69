"""Pictures of many runs for a page: metrics of a sweep or lines with bands flow in, pictures with captions flow out."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from pipeline.page import Picture
from pipeline.printing import add_unit, format_range, shorten
from pipeline.review.curves import Curves, find_interval, half_width
from pipeline.review.selection import order_of, read_number
from pipeline.review.sweep_view import Sweep

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RESOLUTION = 130
MOST_AXES = 4
MOST_CELLS, MOST_PICTURES = 30, 24
"""Values of an axis up to which it can be one of a grid's."""
MOST_LABELLED_CELLS = 12
MOST_LINES = 24
LONGEST_LABEL = 22
LONGEST_LINE_LABEL = 34
BLUE, DARK, GREY = "#0b5fa5", "#1d2530", "#5b6775"
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#1d2530", "#e69f00", "#56b4e9", "#8c6d31")
STYLES = ("-", "--", ":", "-.")
MARKERS = "os^Dv<>P"


def draw_curves(curves: Curves) -> Picture:
    """Draw the lines of a curve, told apart by colour, marker and style."""
    lines = curves.lines[:MOST_LINES]
    rows = -(-len(lines) // 2)
    figure, axes = _new_figure(6.0, 3.7 + 0.19 * rows)
    for index, line in enumerate(lines):
        points = line.points
        x, mean, half = (points[each].to_numpy() for each in ("x", "mean", "half"))
        colour, marker = COLOURS[index % len(COLOURS)], MARKERS[index % len(MARKERS)]
        low, high = find_interval(mean, half, curves.floor)
        axes.fill_between(x, low, high, color=colour, alpha=0.16, lw=0)
        style = STYLES[(index // len(COLOURS)) % len(STYLES)]
        label = _shorten_label(_shorten_middle(line.label, LONGEST_LINE_LABEL), LONGEST_LINE_LABEL)
        every = max(1, len(x) // 15)
        axes.plot(x, mean, style, color=colour, marker=marker, ms=4.5, markevery=every, lw=1.6, label=label)
    axes.set(xlabel=curves.x, ylabel=curves.y)
    if all(float(each).is_integer() for line in lines for each in line.points["x"]):
        axes.xaxis.get_major_locator().set_params(integer=True)
    means, (bottom, top) = pd.concat(line.points["mean"] for line in lines), axes.get_ylim()
    room = 0.4 * np.ptp(means) or 0.1 * abs(means.max()) or 1.0  # a band of two values is wide enough to hide lines
    axes.set_ylim(max(bottom, means.min() - room), min(top, means.max() + room))
    figure.legend(loc="outside lower left", ncols=2, fontsize=8, frameon=False, borderpad=0.1)
    left = len(curves.lines) - len(lines)
    return _make_picture(figure, f"{curves.told}{f'; {left} more lines are in the table alone' if left else ''}.")


def draw_metrics(sweep: Sweep) -> Iterator[tuple[str, list[Picture], str]]:
    """Yield each metric's heading, its pictures, and why it has none, or not all; the last, which decides, first."""
    left, drawn = sweep.axes[MOST_AXES:], 0
    for metric in reversed(sweep.metrics):
        points, head = sweep.points(metric), add_unit(sweep.title(metric), sweep.units.get(metric, "1"))
        if len(points) < 2:
            yield head, [], f"{len(points) or 'no'} job that is done has it as a number: nothing to draw"
        elif not sweep.varying:
            yield head, [], "no key varies"
        elif drawn >= MOST_PICTURES:
            yield head, [], f"{drawn} pictures are enough for a page: see the table"
        else:
            pictures = [*_draw_metric(sweep, metric, head, points)]
            drawn += len(pictures)
            yield head, pictures, f"not drawn over {', '.join(left)}" if left else ""


def _draw_metric(sweep: Sweep, metric: str, head: str, points: pd.DataFrame) -> Iterator[Picture]:
    axes = [each for each in sweep.axes if len(set(points[each])) > 1][:MOST_AXES]
    if not axes:
        points, axes = points.assign(jobs="all"), ["jobs"]
    small = [each for each in axes if len(set(points[each])) <= MOST_CELLS][:3]
    for one, other in combinations(small, 2):
        yield _draw_grid(points, one, other, head, [each for each in sweep.axes if each not in (one, other)])
    for axis in axes:
        others = [each for each in axes if each != axis]
        yield _draw_axis(points, axis, head, others, sweep.seeds, sweep.floor(metric))


def _draw_axis(
    points: pd.DataFrame, axis: str, head: str, others: Sequence[str], seeds: Sequence[str], floor: float
) -> Picture:
    labels = sorted(points[axis].unique(), key=order_of)
    summary = points.groupby(axis)["value"].agg(["mean", "min", "max", "count", "std"]).loc[labels]
    numbers = [read_number(each) for each in labels]
    numeric = all(each is not None and np.isfinite(each) for each in numbers)
    places = np.array(numbers if numeric else range(len(labels)), dtype=float)
    at = dict(zip(labels, places, strict=True))
    figure, axes = _new_figure()
    axes.plot([at[each] for each in points[axis]], points["value"], "o", mfc="none", mec=GREY, alpha=0.6, ms=4)
    mean = summary["mean"].to_numpy()
    if summary["count"].max() > 1:
        if others:
            low, high = summary["min"].to_numpy(), summary["max"].to_numpy()
        else:
            low, high = find_interval(mean, half_width(summary["std"], summary["count"]).to_numpy(), floor)
        axes.errorbar(places, mean, np.vstack([mean - low, high - mean]), fmt="none", ecolor=BLUE, capsize=4, lw=1.4)
    axes.plot(places, mean, "D-" if numeric else "D", color=BLUE, ms=5.5, lw=1.4)
    if numeric:
        if places.min() > 0 and places.max() / places.min() >= 50:
            axes.set_xscale("log")
        if len(places) <= 8:
            axes.set_xticks(places, labels)
            axes.minorticks_off()
        elif axes.get_xscale() == "linear" and all(each.is_integer() for each in places):
            axes.xaxis.get_major_locator().set_params(integer=True)
    else:
        _name_ticks(axes.xaxis, labels)
        axes.margins(x=0.5 / len(labels) + 0.05)
    axes.set(xlabel=_shorten_label(axis, 60), ylabel=_shorten_label(head, 40))
    number = format_range(summary["count"])
    bars = f"bars reach from least to most over {_join([*others, *seeds])}"
    if not others:
        bars = f"bars are the mean's 95 % interval (t) over {_join(seeds) or 'jobs'}"
    caption = f"{head} over {axis}: diamonds are means, circles jobs ({number} for each value)"
    return _make_picture(figure, f"{caption}{f'; {bars}' if summary['count'].max() > 1 else ''}.")


def _draw_grid(points: pd.DataFrame, one: str, other: str, head: str, others: Sequence[str]) -> Picture:
    across, along = (sorted(points[each].unique(), key=order_of) for each in (one, other))
    grouped = points.groupby([other, one])["value"]
    means, counts = (found.unstack().loc[along, across].to_numpy() for found in (grouped.mean(), grouped.count()))
    counts = np.nan_to_num(counts)
    figure, axes = _new_figure(5.7)
    image = axes.imshow(means, aspect="auto", origin="lower", cmap="viridis")
    axes.set_facecolor("white")
    _name_ticks(axes.xaxis, across)
    _name_ticks(axes.yaxis, along, below=False)
    axes.set(xlabel=_shorten_label(one, 60), ylabel=_shorten_label(other, 40))
    axes.grid(visible=False)
    if max(len(across), len(along)) <= MOST_LABELLED_CELLS:
        size = 8.5 if len(across) <= 6 else 6.5
        for (row, column), mean in np.ndenumerate(means):
            text = "none" if np.isnan(mean) else f"{mean:.3g}"
            dark = np.isnan(mean) or image.norm(mean) > 0.6
            axes.text(column, row, text, ha="center", va="center", size=size, color=DARK if dark else "white")
    figure.colorbar(image, ax=axes, label=_shorten_label(head, 40))
    number = format_range(counts)
    over = f", over all of {_join(others)}" if others else ""
    white = "; white cells have none" if counts.min() == 0 else ""
    return _make_picture(figure, f"{head}: mean of the jobs in each cell ({number}{over}){white}.")


def _name_ticks(axis: Any, labels: Sequence[str], below: bool = True) -> None:
    """Name ticks, of many only some; long names below the axes are slanted."""
    step = -(-len(labels) // 16)
    shown = [_shorten_label(each, LONGEST_LABEL) if index % step == 0 else "" for index, each in enumerate(labels)]
    slanted = below and sum(map(len, shown)) > 40
    style = {"rotation": 30, "ha": "right", "rotation_mode": "anchor"} if slanted else {}
    axis.set_ticks(range(len(labels)), shown, **style)


def _join(names: Sequence[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _new_figure(width: float = 5.2, height: float = 3.3) -> tuple[Figure, Any]:
    """Return a figure of so many inches and its axes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.subplots()
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#dde3ea", lw=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=9)
    return figure, axes


def _make_picture(figure: Figure, caption: str) -> Picture:
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=RESOLUTION, pil_kwargs={"compress_level": 3})
    return Picture(stream.getvalue(), caption)


def _shorten_middle(text: str, most: int) -> str:
    """Return a text with its middle left out where it is long, as what tells lines apart often stands at its end."""
    return text if len(text) <= most else f"{text[: most // 3]}...{text[-(most - most // 3 - 3) :]}"


def _shorten_label(text: str, most: int) -> str:
    """Return a label that is not longer than so many characters, and no formula."""
    return shorten(text.replace("$", r"\$"), most)
