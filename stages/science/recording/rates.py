"""Records of unequal rates, resampled to the lowest of them behind a low-pass filter against aliasing.

Tidy frames with signals side by side flow in, each record on a uniform clock of its own; one frame on one clock flows
out, with notes of what was resampled.
"""

from collections.abc import Mapping, Sequence
from fractions import Fraction

import numpy as np
import pandas as pd

from stages.science.recording.assembly import Notes
from stages.science.recording.clock import SAME_RATE, find_rate
from stages.science.recording.columns import RecordingError
from stages.science.signals.trajectories import Array

MOST_SAMPLES_TO_ONE = 10000
"""Largest number in a ratio of rates."""
PERIODS, KAISER, CUTOFF = 20, 8.0, 0.872
"""Half the filter's length in samples of the lower rate, its window, and its cut-off over half that rate: it is flat up
to 0.74 of that half, and a ten thousandth passes from the half on."""


def find_rates(frame: pd.DataFrame, stated_hz: float | None) -> dict[str, float]:
    """Return samples per second of each record; those that agree within a hundredth have the same.

    The frame has ``record`` and ``time_s``; a rate that is stated is that of all. Raises as `find_rate`.
    """
    names = [str(name) for name in frame["record"].unique()]
    if stated_hz is not None or len(names) == 1:
        return dict.fromkeys(names, find_rate(frame, ("record",), stated_hz))
    own = {}
    for name, rows in frame.groupby("record", sort=False):
        try:
            own[str(name)] = find_rate(rows, ("record",), None)
        except RecordingError as error:
            raise RecordingError(f"record {name}: {error}") from None
    found: dict[str, float] = {}
    for name in names:
        alike = [each for each in names if abs(own[each] / own[name] - 1.0) <= SAME_RATE]
        shared = next((found[each] for each in alike if each in found), None)
        found[name] = shared or find_rate(frame[frame["record"].isin(alike)], ("record",), None)
    return found


def equalise(
    frame: pd.DataFrame, rates_hz: Mapping[str, float], signals: Sequence[str], largest_drift: float, notes: Notes
) -> tuple[pd.DataFrame, float]:
    """Return all records at the lowest of their rates, and that rate.

    The frame has ``record``, ``time_s`` from 0 in each and the signals, nan where nothing was measured. As a rate is
    taken for a simple multiple, a record's last sample may be off by `largest_drift` samples. The notes receive what
    was resampled.
    """
    lowest = min(rates_hz.values())
    if max(rates_hz.values()) == lowest:
        return frame, lowest
    pieces = []
    for name, rows in frame.groupby("record", sort=False):
        rate = rates_hz[str(name)]
        if rate == lowest:
            pieces.append(rows)
            continue
        ratio = _find_ratio(lowest / rate, len(rows), largest_drift)
        made = {signal: _resample(rows[signal].to_numpy(dtype=float), ratio) for signal in signals}
        count = len(next(iter(made.values())))
        pieces.append(pd.DataFrame({"record": name, "time_s": np.arange(count) / lowest, **made}))
        told = f"resampled from {rate:.6g} Hz to {lowest:.6g} Hz, the lowest rate of all records"
        notes.append((f"record {name}", f"{told}, behind a filter against aliases"))
    return pd.concat(pieces, ignore_index=True), lowest


def _find_ratio(ratio: float, samples: int, largest_drift: float) -> Fraction:
    """Return the simplest fraction that leaves the last sample in its place."""
    for most in (10, 100, 1000, MOST_SAMPLES_TO_ONE):
        simple = Fraction(ratio).limit_denominator(most)
        if simple > 0 and abs(float(simple) - ratio) * samples <= max(largest_drift, 1e-9):
            break
    return simple


def _resample(values: Array, ratio: Fraction) -> Array:
    """Return values at `ratio` times their rate; nan where one of those about it is missing."""
    from scipy.signal import firwin, resample_poly

    missing = ~np.isfinite(values)
    if missing.all():
        return np.full(len(range(0, len(values) * ratio.numerator, ratio.denominator)), np.nan)
    known = np.flatnonzero(~missing)
    bridged = np.interp(np.arange(len(values)), known, values[known])
    widest = max(ratio.numerator, ratio.denominator)
    lowpass = firwin(2 * PERIODS * widest + 1, CUTOFF / widest, window=("kaiser", KAISER))
    up, down = ratio.numerator, ratio.denominator
    made: Array = resample_poly(bridged, up, down, window=lowpass, padtype="antireflect")  # type: ignore[call-overload]
    at, reach = np.arange(len(made)) / float(ratio), 1.0 / float(ratio)
    before = np.concatenate([[0], np.cumsum(missing)])
    low = np.clip(np.ceil(at - reach).astype(int), 0, len(values))
    high = np.clip(np.floor(at + reach).astype(int) + 1, 0, len(values))
    made[before[high] > before[low]] = np.nan
    return made
