"""Clocks with uneven steps: samples of a rounded clock are counted, other records are resampled to an even clock.

Rows of a record flow in with the times that its recorder wrote; they flow out on an even clock, with notes on what was
done.
"""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from stages.science.recording.assembly import Notes
from stages.science.recording.columns import RecordingError
from stages.science.signals.trajectories import Array

FEWEST = 10
"""Smallest number of samples of a record whose clock is examined."""
FINEST_DECIMAL = 9
"""Decimals of a second to which a clock may be rounded."""
ROUNDED_OFF = 0.75
"""Largest distance of a rounded time from an even clock, in units of its last digit: half, and what a fit adds."""
AROUND, MOST_GAPS = 50, 1000
"""Samples on each side of a gap whose mean time gives its length, and largest number of gaps in a rounded clock."""
ONE_PERIOD = 1.75
"""Largest step without a missing sample, in median steps."""
LONGEST_BRIDGE = 3.0
"""Longest step between two samples that is interpolated, in samples of the even clock."""
MOST_LOST = 0.5
"""Largest share of samples without values after resampling; a record with more is refused."""


def even_out(frame: pd.DataFrame, signals: Sequence[str], largest_jitter: float, notes: Notes) -> pd.DataFrame:
    """Return the frame with every record on an even clock, but for rows that are missing.

    The frame has ``record``, ``part``, ``time_s`` in the order of time, and the signals. A record whose steps deviate
    from whole periods by `largest_jitter` of one at most stays as it is; the notes receive what was done to the others.
    A `RecordingError` tells that most of a record's samples on an even clock would have no values.
    """
    pieces, known = [], len(notes)
    for name, rows in frame.groupby("record", sort=False):
        made, told = _even_out_one(rows, signals, largest_jitter)
        pieces.append(made)
        notes += [(f"record {name}", told)] if told else []
    return pd.concat(pieces, ignore_index=True) if len(notes) > known else frame


def _even_out_one(rows: pd.DataFrame, signals: Sequence[str], largest_jitter: float) -> tuple[pd.DataFrame, str]:
    """Return a record on an even clock, and what was done: nothing where it is on one, or its times are wrong."""
    times = rows["time_s"].to_numpy(dtype=float)
    steps = np.diff(times)
    wrong = len(times) < FEWEST or not np.isfinite(times).all() or steps.min() < 0.0 or steps.max() == 0.0
    if wrong or not is_uneven(times, largest_jitter):
        return rows, ""
    twice = rows.duplicated(["time_s", *signals]).to_numpy()
    if twice.any() and not is_uneven(times[~twice], largest_jitter):
        return rows, ""  # rows that were written twice, on a clock that is not rounded
    counted = count_rounded(times)
    if counted is not None:
        digit, even_s, rate = counted
        return rows.assign(time_s=even_s), f"its times are rounded to {digit:g} s: samples counted at {rate:.6g} Hz"
    if steps.min() == 0.0:
        return rows, ""
    ordinary = steps[steps < ONE_PERIOD * np.median(steps)]
    rate = float(f"{1.0 / ordinary.mean():.9g}")
    even = _resample(rows, signals, rate)
    lost = float(even[list(signals)].isna().all(axis=1).mean())
    told = f"time steps of {steps.min():.4g} to {steps.max():.4g} s"
    if lost > MOST_LOST:
        raise RecordingError(
            f"column time_s: expected samples about evenly in time, got {told} in record {rows['record'].iloc[0]}: at "
            f"their usual rate, {rate:.6g} Hz, {100.0 * lost:.0f} % of all samples would have no values; resample it"
        )
    return even, f"{told} put on an even clock of {rate:.6g} Hz, by straight lines between samples"


def is_uneven(times_s: Array, largest_jitter: float) -> bool:
    """Return whether the steps of (N,) times deviate from whole periods by more than a share of a period."""
    steps = np.diff(times_s)
    usual = float(np.median(steps))
    if steps.min() <= 0.0:
        return True
    near = steps[np.abs(steps / usual - 1.0) < 0.5]
    periods = steps / near.mean()
    whole = np.maximum(np.round(periods), 1.0)
    return bool((np.abs(periods - whole) > largest_jitter * whole).any())


def count_rounded(times_s: Array) -> tuple[float, Array, float] | None:
    """Return the last digit of a rounded clock (s), the even times that it rounds, and its rate (Hz); None for others.

    The (N,) times are in their order; rows may be missing.
    """
    digit = _find_digit(times_s)
    if digit is None or not np.ptp(times_s):
        return None
    steps = np.diff(times_s)
    near = steps < np.quantile(steps, 0.01) + 1.5 * digit  # a period is rounded up or down
    if np.count_nonzero(~near) > MOST_GAPS:
        return None
    period = float(steps[near].mean())
    if period < digit:  # several samples share a time: no row tells that one before it is missing
        near[:] = True
    whole = np.where(near, 1.0, np.maximum(np.round(steps / period), 1.0))
    since = times_s - times_s[0]
    for gap in np.flatnonzero(~near) + 1:
        phase = since - period * np.concatenate([[0.0], np.cumsum(whole)])
        jump = phase[gap : gap + AROUND].mean() - phase[max(gap - AROUND, 0) : gap].mean()
        whole[gap - 1] = max(whole[gap - 1] + np.round(jump / period), 1.0)
    count = np.concatenate([[0.0], np.cumsum(whole)])
    period = float(np.polyfit(count, times_s, 1)[0])
    rate_hz = _shorten(1.0 / period, digit / (period * len(count) ** 1.5))
    even = count / rate_hz
    even += 0.5 * ((times_s - even).max() + (times_s - even).min())
    return (digit, even, rate_hz) if np.abs(times_s - even).max() < ROUNDED_OFF * digit else None


def _shorten(rate_hz: float, error: float) -> float:
    """Return the rate with the fewest digits that is right within a relative error."""
    shorter = (float(f"{rate_hz:.{digits}g}") for digits in range(1, 16))
    return next(each for each in shorter if abs(each / rate_hz - 1.0) <= max(error, 1e-14))


def _find_digit(times_s: Array) -> float | None:
    """Return the coarsest decimal of a second of which all times are multiples."""
    for decimals in range(FINEST_DECIMAL + 1):
        places = (times_s - times_s[0]) * 10.0**decimals
        if (np.abs(places - np.round(places)) < 1e-4).all():
            return float(10.0**-decimals)
    return None


def _resample(rows: pd.DataFrame, signals: Sequence[str], rate_hz: float) -> pd.DataFrame:
    """Return a record at even times, on straight lines between its samples; none across gaps."""
    times = rows["time_s"].to_numpy(dtype=float)
    even = times[0] + np.arange(int((times[-1] - times[0]) * rate_hz * (1.0 + 1e-12)) + 1) / rate_hz
    longest = LONGEST_BRIDGE / rate_hz
    made = {}
    for name in signals:
        values = rows[name].to_numpy(dtype=float)
        known = np.isfinite(values)
        own = times[known]
        if not len(own):
            made[name] = np.full(len(even), np.nan)
            continue
        after = np.clip(np.searchsorted(own, even), 1, max(len(own) - 1, 1))
        inside = (even >= own[0]) & (even <= own[-1])
        bridged = (own[np.minimum(after, len(own) - 1)] - own[after - 1] <= longest) | np.isin(even, own)
        made[name] = np.where(inside & bridged, np.interp(even, own, values[known]), np.nan)
    return pd.DataFrame({"record": rows["record"].iloc[0], "part": rows["part"].iloc[0], "time_s": even, **made})
