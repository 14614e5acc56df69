"""Values that a sensor shows again and again, exactly: the levels at which it ends, and the count it goes by."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from stages.science.signals.trajectories import Array

LEAST_SHARE, LEAST_COUNT = 0.005, 20
"""Share and number of samples at exactly the largest or smallest value from which it is taken for a level."""
OFTEN = 4.0
"""How much more often a level comes than any value between the ends."""
SAME = 1e-9
"""Difference, over the largest value, of values that are one."""
MOST_DISTINCT = 0.1
"""Distinct values over samples, up to which a sensor may go by counts."""
REGULAR = 0.02
"""How far, in counts, distinct values may be from whole numbers of them."""


class Levels(NamedTuple):
    """Ends of what a sensor shows, in the signal's unit; None where the values show none."""

    lowest: float | None
    highest: float | None


def find_levels(values: Array) -> Levels:
    """Return the levels at which a signal is clipped.

    Noise makes every value of a sensor differ from the next; where the largest or the smallest comes again and again it
    is the end of the scale. A sensor that goes by counts repeats every value, and one that rests between its ends too
    repeats that: neither shows a level.
    """
    if values.size == 0 or np.ptp(values) == 0.0 or find_count(values) is not None:
        return Levels(None, None)
    distinct, counts = np.unique(values, return_counts=True)
    near = SAME * float(np.abs(distinct[[0, -1]]).max())
    below, above = distinct <= distinct[0] + near, distinct >= distinct[-1] - near
    least = max(LEAST_COUNT, LEAST_SHARE * values.size, OFTEN * counts[~(below | above)].max(initial=0))
    lowest, highest = (
        float(distinct[end]) if counts[at].sum() > least else None for end, at in ((0, below), (-1, above))
    )
    return Levels(lowest, highest)


def find_count(values: Array) -> float | None:
    """Return the count of which all values are whole multiples, in the signal's unit, or None."""
    distinct = np.unique(values)
    if not 2 < distinct.size < MOST_DISTINCT * values.size:
        return None
    steps = np.diff(distinct)
    step = float(steps[steps > 1e-3 * np.median(steps)].min())
    multiples = np.round(distinct / step)
    size = float((distinct @ multiples) / (multiples @ multiples))
    off = np.abs(distinct / size - np.round(distinct / size))
    return size if float(np.quantile(off, 0.9)) < REGULAR else None
