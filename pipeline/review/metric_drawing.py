"""Figures of many runs: numbers flow in, pictures with captions for a page flow out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd

from pipeline.review.intervals import half_width
from pipeline.review.pictures import Margins, Picture, make_picture, new_figure, shorten_label
from pipeline.review.selection import order_of, read_number
from pipeline.review.sweep_view import Sweep, summarise

MOST_AXES = 4
MOST_CELLS = 30
"""Values of an axis up to which it can be one of a grid's."""
MOST_LABELLED_CELLS = 12
MOST_PANELS = 24
LONGEST_LABEL = 22
INCHES_OF_A_LETTER = 0.075
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
        yield _draw_repeats(points["value"].to_numpy(), head, sweep.seeds)
        return
    small = [each for each in axes if len(set(points[each])) <= MOST_CELLS][:3]
    for one, other in combinations(small, 2):
        yield _draw_grid(points, one, other, head, [each for each in sweep.axes if each not in (one, other)])
    for axis in axes:
        yield _draw_axis(points, axis, head, [each for each in axes if each != axis], sweep.seeds)


def _draw_repeats(values: np.ndarray[Any, Any], head: str, seeds: Sequence[str]) -> Picture:
    figure, axes = new_figure(margins=Margins())
    mean, half = float(values.mean()), half_width(float(values.std(ddof=1)), len(values))
    axes.axhspan(mean - half, mean + half, color=BLUE, alpha=0.15, lw=0)
    axes.axhline(mean, color=BLUE, lw=1.8)
    axes.plot(range(1, len(values) + 1), values, "o", mfc="none", mec=GREY, ms=4.5)
    axes.set(xlabel="job", ylabel=shorten_label(head, 40))
    axes.xaxis.get_major_locator().set_params(integer=True)
    caption = (
        f"{head}: line is the mean of {len(values)} jobs, {mean:.4g}; band its 95 % interval (t), "
        f"{mean - half:.4g} to {mean + half:.4g}; circles are jobs, which differ in {_join(seeds) or 'nothing'}."
    )
    return make_picture(figure, caption)


def _draw_axis(points: pd.DataFrame, axis: str, head: str, others: Sequence[str], seeds: Sequence[str]) -> Picture:
    summary = summarise(points, [axis])
    summary = summary.iloc[sorted(range(len(summary)), key=lambda row: order_of(summary[axis].iloc[row]))]
    labels = summary[axis].tolist()
    numbers = [read_number(each) for each in labels]
    numeric = all(each is not None and np.isfinite(each) for each in numbers)
    places = np.array(numbers if numeric else range(len(labels)), dtype=float)
    at = dict(zip(labels, places, strict=True))
    below = 0.0 if numeric else _room_below(labels)
    figure, axes = new_figure(height=3.3 + below, margins=Margins(bottom=0.55 + below))
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
    least, most = int(summary["count"].min()), int(summary["count"].max())
    number = f"{least}" if least == most else f"{least} to {most}"
    bars = f"bars reach from least to most over {_join([*others, *seeds])}"
    if not others:
        bars = f"bars are the mean's 95 % interval (t) over {_join(seeds) or 'jobs'}"
    caption = f"{head} over {axis}: diamonds are means, circles jobs ({number} for each value)"
    return make_picture(figure, f"{caption}{f'; {bars}' if most > 1 else ''}.")


def _draw_grid(points: pd.DataFrame, one: str, other: str, head: str, others: Sequence[str]) -> Picture:
    summary = summarise(points, [one, other])
    across, along = (sorted(points[each].unique(), key=order_of) for each in (one, other))
    means = summary.pivot(index=other, columns=one, values="mean").reindex(index=along, columns=across)
    counts = summary.pivot(index=other, columns=one, values="count").reindex(index=along, columns=across).fillna(0)
    below, beside = _room_below(across), INCHES_OF_A_LETTER * min(max(map(len, along)), LONGEST_LABEL)
    figure, axes = new_figure(5.7, 3.3 + below, Margins(0.5 + beside, 0.65, 0.55 + below))
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
    least, most = int(counts.to_numpy().min()), int(counts.to_numpy().max())
    number = f"{least}" if least == most else f"{least} to {most}"
    over = f", over all of {_join(others)}" if others else ""
    caption = f"{head}: mean of the jobs in each cell ({number}{over}); white cells have none."
    return make_picture(figure, caption if least == 0 else caption.replace("; white cells have none", ""))


def _room_below(labels: Sequence[str]) -> float:
    """Return the inches that labels below axes need beyond one line."""
    return 0.5 * INCHES_OF_A_LETTER * max(map(len, _shown(labels))) if _are_slanted(labels) else 0.0


def _are_slanted(labels: Sequence[str]) -> bool:
    return sum(map(len, _shown(labels))) > 40


def _shown(labels: Sequence[str]) -> list[str]:
    step = -(-len(labels) // 16)
    return [shorten_label(each, LONGEST_LABEL) if index % step == 0 else "" for index, each in enumerate(labels)]


def _name_ticks(axis: Any, labels: Sequence[str], below: bool = True) -> None:
    slant = {"rotation": 30, "ha": "right", "rotation_mode": "anchor"} if below and _are_slanted(labels) else {}
    axis.set_ticks(range(len(labels)), _shown(labels), **slant)


def _join(names: Sequence[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
