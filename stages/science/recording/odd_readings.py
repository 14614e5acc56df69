"""Readings that no sensor makes by itself: repeated evenly, stuck at one value, far from those around, in another unit.

Records flow in; notes for people flow out. No sample is changed.
"""

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from stages.science.recording.assembly import Notes
from stages.science.signals.trajectories import Array

FEWEST_RUNS, ALIKE = 50, 0.8
"""Runs of equal readings of which, and share of them that have to be of one length, to say that each is repeated."""
LONGEST, FEWEST_EQUAL = 20.0, 50
"""Length over that of nearly all runs, and readings, from which a run of equal ones is a sensor that is stuck."""
APART, AROUND = 15.0, 5
"""Deviations from the median of so many readings, over that of one from the mean of its neighbours, by which it stands
apart."""
LEAST_SHARE = 0.01
"""Share of the range by which it is off at least."""
OTHER_SCALE = 100.0
"""How many times the range of a signal in one record is that in others, or less, that may be of another unit."""
TO_DEVIATION = 1.4826
"""Standard deviation of a normal variable over its median absolute deviation."""


def note_odd_readings(frame: pd.DataFrame, signals: Sequence[str]) -> Notes:
    """Return what is odd in the signals of records, by signal: rows of ``record``, ``time_s`` and the signals."""
    records = frame.groupby("record", sort=False)[list(signals)]
    ratios = (records.max() - records.min()).replace(0.0, np.nan)
    ratios /= ratios.median()
    notes: Notes = [
        (signal, f"range in record {record} {ratio:.2g} times that in most: is it in another unit?")
        for signal in signals
        for record, ratio in ratios[signal].dropna().items()
        if not 1.0 / OTHER_SCALE < ratio < OTHER_SCALE
    ]
    several = len(ratios) > 1
    for record, rows in frame.groupby("record", sort=False):
        where = f" of record {record}" if several else ""
        time_s = rows["time_s"].to_numpy(dtype=float)
        for signal in signals:
            values = rows[signal].to_numpy(dtype=float)
            told = np.isfinite(values)
            if told.sum() > AROUND and np.ptp(values[told]) > 0.0:
                notes += [(signal, f"{note}{where}") for note in _describe(time_s[told], values[told])]
    return notes


def _describe(time_s: Array, values: Array) -> Iterator[str]:
    begins = np.flatnonzero(np.diff(values, prepend=np.nan) != 0.0)
    lengths = np.diff(begins, append=len(values))
    usual, step_s = int(np.median(lengths)), float(np.median(np.diff(time_s)))
    if usual > 1 and len(lengths) >= FEWEST_RUNS and np.mean(lengths == usual) >= ALIKE:
        late_s = 0.5 * (usual - 1) * step_s
        yield f"each reading is repeated {usual} times; if it is read so rarely, it is {late_s:.3g} s late on average"
        return
    longest = int(np.argmax(lengths))
    at, count = begins[longest], int(lengths[longest])
    fine = len(np.unique(values)) > 0.5 * (len(values) - count)
    inside = fine and values.min() < values[at] < values.max()
    if usual == 1 and inside and count >= max(FEWEST_EQUAL, LONGEST * float(np.quantile(lengths, 0.99))):
        last_s = time_s[at + count - 1]
        yield f"{count} equal readings of {values[at]:.6g}, from {time_s[at]:.6g} to {last_s:.6g} s: at rest, or stuck"
    apart = find_apart(values)
    if len(apart):
        size = np.abs(values[apart] - _find_middle(values)[apart]).max()
        yield (
            f"{len(apart)} single reading{'s' * (len(apart) > 1)} far from those around, by up to {size:.3g}, first at "
            f"{time_s[apart[0]]:.6g} s"
        )


def find_apart(values: Array) -> NDArray[np.intp]:
    """Return the places in a signal, (N,), of single readings far from those around; none where most are equal."""
    bent = np.abs(values[1:-1] - 0.5 * (values[:-2] + values[2:]))
    least = max(APART * TO_DEVIATION * float(np.median(bent)), LEAST_SHARE * float(np.ptp(values)))
    odd = np.abs(values - _find_middle(values)) > least
    alone = odd & ~np.roll(odd, 1) & ~np.roll(odd, -1)
    return np.flatnonzero(alone) if np.median(bent) > 0.0 else np.empty(0, dtype=np.intp)


def _find_middle(values: Array) -> Array:
    """Return the median of the readings around each, (N,)."""
    around = np.lib.stride_tricks.sliding_window_view(np.pad(values, AROUND // 2, mode="edge"), AROUND)
    return np.asarray(np.median(around, axis=1))
