"""Values that a sensor repeats exactly: the levels at which it saturates, and its quantisation step."""

from typing import NamedTuple

import numpy as np

from stages.science.output_channels.output_channel import DetectionSettings
from stages.science.signals.trajectories import Array

SAME = 1e-9
"""Difference, over the largest value, up to which two values are equal."""


class Levels(NamedTuple):
    """Saturation levels in the signal's unit; None where the values show none."""

    lowest: float | None
    highest: float | None


def find_levels(values: Array, limits: DetectionSettings) -> Levels:
    """Return the levels at which a signal over time, (T, ...), is clipped; what is not finite was not measured.

    Noise makes every value of a sensor differ from the next, so a largest or smallest value that recurs exactly is the
    end of the scale. A signal at rest between the ends repeats that value and shows no level, nor does one in counts
    that are not finer than its noise, of which every value recurs.
    """
    series, values = values, values[np.isfinite(values)]
    if values.size == 0 or np.ptp(values) == 0.0:
        return Levels(None, None)
    count = find_count(values, limits)
    if count is not None and _estimate_noise(series, values.min(), values.max()) < count:
        return Levels(None, None)
    distinct, counts = np.unique(values, return_counts=True)
    near = SAME * float(np.abs(distinct[[0, -1]]).max())
    below, above = distinct <= distinct[0] + near, distinct >= distinct[-1] - near
    usual = limits.saturation_ratio * counts[~(below | above)].max(initial=0)
    least = max(limits.saturation_samples, limits.saturation_share * values.size, usual)
    lowest, highest = (
        float(distinct[end]) if counts[at].sum() > least else None for end, at in ((0, below), (-1, above))
    )
    return Levels(lowest, highest)


def _estimate_noise(series: Array, lowest: float, highest: float) -> float:
    """Return the deviation of white noise that would explain the second differences of a signal between its ends."""
    between = np.where((series > lowest) & (series < highest), series, np.nan)
    second = np.diff(between, 2, axis=0)
    known = second[np.isfinite(second)]
    return float(np.sqrt(np.mean(known**2) / 6.0)) if known.size else 0.0


def find_count(values: Array, limits: DetectionSettings) -> float | None:
    """Return the quantisation step of which all values are whole multiples, in the signal's unit, or None."""
    distinct = np.unique(values)
    if not 2 < distinct.size < limits.quantised_share * values.size:
        return None
    steps = np.diff(distinct)
    step = float(steps[steps > 1e-3 * np.median(steps)].min())
    multiples = np.round(distinct / step)
    size = float((distinct @ multiples) / (multiples @ multiples))
    off = np.abs(distinct / size - np.round(distinct / size))
    return size if float(np.quantile(off, 0.9)) < limits.quantised_deviation else None
