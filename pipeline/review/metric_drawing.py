"""Figures of many runs: numbers flow in, pictures with captions for a page flow out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd

from pipeline.page import Picture
from pipeline.printing import format_range
from pipeline.review.pictures import half_width, make_picture, new_figure, shorten_label
from pipeline.review.selection import order_of, read_number
from pipeline.review.sweep_view import Sweep, summarise

MOST_AXES = 4
MOST_CELLS = 30
"""Values of an axis up to which it can be one of a grid's."""
MOST_LABELLED_CELLS = 12
MOST_PANELS = 24
LONGEST_LABEL = 22
BLUE, DARK, GREY = "#0b5fa5", "#1d2530", "#5b6775"


def draw_metrics(sweep: Sweep) -> Iterator[tuple[str, list[Picture], str]]:
    """Yield each metric's heading, its pictures, and why it has none, or not all."""
    drawn = 0
    for metric in sweep.metrics:
        points = sweep.points(metric)
        if len(points) < 2:
            yield sweep.head(metric), [], f"{len(points) or 'no'} job that is done has it as a number: nothing to draw"
            continue
        if not sweep.varying or drawn >= MOST_PANELS:
            told = "no key varies" if not sweep.varying else f"{drawn} pictures are enough for a page: see the table"
            yield sweep.head(metric), [], told
            continue
        pictures = list(_draw_metric(sweep, metric, points))
        drawn += len(pictures)
        left = sweep.axes[MOST_AXES:]
        yield sweep.head(metric), pictures, f"not drawn over {', '.join(left)}" if left else ""


def _draw_metric(sweep: Sweep, metric: str, points: pd.DataFrame) -> Iterator[Picture]:
    head = sweep.head(metric)
    axes = [each for each in sweep.axes if len(set(points[each])) > 1][:MOST_AXES]
    if not axes:
        points, axes = points.assign(jobs="all"), ["jobs"]
    small = [each for each in axes if len(set(points[each])) <= MOST_CELLS][:3]
    for one, other in combinations(small, 2):
        yield _draw_grid(points, one, other, head, [each for each in sweep.axes if each not in (one, other)])
    for axis in axes:
        yield _draw_axis(points, axis, head, [each for each in axes if each != axis], sweep.seeds)


def _draw_axis(points: pd.DataFrame, axis: str, head: str, others: Sequence[str], seeds: Sequence[str]) -> Picture:
    summary = summarise(points, [axis])
    summary = summary.iloc[sorted(range(len(summary)), key=lambda row: order_of(summary[axis].iloc[row]))]
    labels = summary[axis].tolist()
    numbers = [read_number(each) for each in labels]
    numeric = all(each is not None and np.isfinite(each) for each in numbers)
    places = np.array(numbers if numeric else range(len(labels)), dtype=float)
    at = dict(zip(labels, places, strict=True))
    figure, axes = new_figure()
    axes.plot([at[each] for each in points[axis]], points["value"], "o", mfc="none", mec=GREY, alpha=0.6, ms=4)
    mean = summary["mean"].to_numpy()
    if summary["count"].max() > 1:
        if others:
            down, up = mean - summary["min"].to_numpy(), summary["max"].to_numpy() - mean
        else:
            down = up = np.array([half_width(*each) for each in zip(summary["std"], summary["count"], strict=True)])
        axes.errorbar(places, mean, np.vstack([down, up]), fmt="none", ecolor=BLUE, capsize=4, lw=1.4)
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
    axes.set(xlabel=shorten_label(axis, 60), ylabel=shorten_label(head, 40))
    number = format_range(summary["count"])
    bars = f"bars reach from least to most over {_join([*others, *seeds])}"
    if not others:
        bars = f"bars are the mean's 95 % interval (t) over {_join(seeds) or 'jobs'}"
    caption = f"{head} over {axis}: diamonds are means, circles jobs ({number} for each value)"
    return make_picture(figure, f"{caption}{f'; {bars}' if summary['count'].max() > 1 else ''}.")


def _draw_grid(points: pd.DataFrame, one: str, other: str, head: str, others: Sequence[str]) -> Picture:
    summary = summarise(points, [one, other])
    across, along = (sorted(points[each].unique(), key=order_of) for each in (one, other))
    means = summary.pivot(index=other, columns=one, values="mean").reindex(index=along, columns=across)
    counts = summary.pivot(index=other, columns=one, values="count").reindex(index=along, columns=across).fillna(0)
    figure, axes = new_figure(5.7)
    image = axes.imshow(means.to_numpy(), aspect="auto", origin="lower", cmap="viridis")
    axes.set_facecolor("white")
    _name_ticks(axes.xaxis, across)
    _name_ticks(axes.yaxis, along, below=False)
    axes.set(xlabel=shorten_label(one, 60), ylabel=shorten_label(other, 40))
    axes.grid(visible=False)
    if max(len(across), len(along)) <= MOST_LABELLED_CELLS:
        size = 8.5 if len(across) <= 6 else 6.5
        for (row, column), mean in np.ndenumerate(means.to_numpy()):
            text = "none" if np.isnan(mean) else f"{mean:.3g}"
            dark = np.isnan(mean) or image.norm(mean) > 0.6
            axes.text(column, row, text, ha="center", va="center", size=size, color=DARK if dark else "white")
    figure.colorbar(image, ax=axes, label=shorten_label(head, 40))
    number = format_range(counts.to_numpy())
    over = f", over all of {_join(others)}" if others else ""
    white = "; white cells have none" if counts.to_numpy().min() == 0 else ""
    return make_picture(figure, f"{head}: mean of the jobs in each cell ({number}{over}){white}.")


def _name_ticks(axis: Any, labels: Sequence[str], below: bool = True) -> None:
    """Name ticks, of many only some; long names below the axes are slanted."""
    step = -(-len(labels) // 16)
    shown = [shorten_label(each, LONGEST_LABEL) if index % step == 0 else "" for index, each in enumerate(labels)]
    slanted = below and sum(map(len, shown)) > 40
    axis.set_ticks(
        range(len(labels)), shown, **({"rotation": 30, "ha": "right", "rotation_mode": "anchor"} if slanted else {})
    )


def _join(names: Sequence[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
