"""Values that a sensor shows again and again, exactly: the level at which it ends, and the count it goes by."""

from __future__ import annotations

import numpy as np

from stages.signals.trajectories import Array

LEAST_SHARE, LEAST_COUNT = 0.005, 20
"""Share and number of samples at exactly the largest value from which it is taken for a level."""
OFTEN = 4.0
"""How much more often the largest value comes than any other."""
MOST_DISTINCT = 0.1
"""Distinct values over samples, up to which a sensor may go by counts."""
REGULAR = 0.02
"""How far, in counts, distinct values may be from whole numbers of them."""


def find_level(values: Array) -> float | None:
    """Return the level at which a signal is clipped, in its unit, or None.

    Noise makes every value of a sensor differ from the next; where the largest comes again and again it is the end of
    the scale. A sensor that goes by counts repeats every value, and one that rests elsewhere too repeats that: neither
    shows such a level.
    """
    if values.size == 0 or find_count(values) is not None:
        return None
    largest = float(values.max())
    count = int((values >= largest - 1e-9 * max(abs(largest), 1.0)).sum())
    if largest <= 0.0 or count < max(LEAST_COUNT, LEAST_SHARE * values.size):
        return None
    others = np.unique(values, return_counts=True)[1][:-1]
    return largest if count > OFTEN * others.max(initial=0) else None


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
