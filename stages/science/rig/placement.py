"""A recorded trial on the machine's clock: as it was sampled, or resampled with what is missing marked.

Adopted rows of one trial flow in, as they were recorded; as many samples as a trial of the machine has flow out for
each muscle, or a `RecordingError` that names rows and what to set.
"""

import math

import numpy as np
import pandas as pd

from stages.science.recording.assembly import READINGS
from stages.science.recording.clock import SAME_RATE, find_rate, regularise
from stages.science.recording.columns import RecordingError, name_rows
from stages.science.rig.reference import PUNCTUAL
from stages.science.signals.trajectories import Array

HELD = ("pressure_command_kpa", *PUNCTUAL)
"""Columns whose values hold until the next sample."""
A_ROUNDING = 1e-6
"""Share of a sample by which a time may miss a whole number of them."""
A_GAP = 1.5
"""Steps of time, over the usual one, from which on samples are missing in between."""


def keep(rows: pd.DataFrame, rate_hz: float, samples: int, largest_jitter: float) -> pd.DataFrame:
    """Return the rows of a trial that is sampled as the machine is, on its clock; the jitter is as of `regularise`.

    Rows are adopted columns, in the order of time within each muscle; their index counts the rows of the file. Those at
    times below 0 are the lead-in, which is of any length. A `RecordingError` tells that rate or length differ, or that
    something is missing.
    """
    own_hz = find_rate(rows, ("muscle",), None)
    if abs(own_hz / rate_hz - 1.0) > SAME_RATE:
        raise RecordingError(
            f"column time_s: expected the exoskeleton's {rate_hz:g} Hz, got {own_hz:.6g} Hz; set "
            f"rig.resample=true, or exoskeleton.sampling_rate_hz={own_hz:.6g}"
        )
    steps = rows.groupby("muscle", sort=False)["time_s"].diff() * rate_hz
    if (steps > A_GAP).any():
        lost = int((steps[steps > A_GAP].round() - 1).max())
        raise RecordingError(
            f"column time_s: nothing for {lost} samples before {name_rows(steps > A_GAP)}; record it anew, or set "
            "rig.resample=true, which marks what is missing"
        )
    for name in [each for each in READINGS if each in rows]:
        if rows[name].isna().any():
            raise RecordingError(
                f"column {name}: expected a value in every row, got none in {name_rows(rows[name].isna())}; set "
                "rig.resample=true, which marks what is missing"
            )
    placed, _ = regularise(rows, "trial", ["muscle"], rate_hz, largest_jitter)
    lead = max(round(-float(rows["time_s"].min()) * rate_hz), 0)
    counts = placed.groupby("muscle")["time_s"].size() - lead
    if (counts != samples).any():
        count = int(counts[counts != samples].iloc[0])
        remedy = "rig.resample=true, which cuts it, or " if count > samples else ""
        raise RecordingError(
            f"expected the {samples} samples of a trial, got {count}; set {remedy}"
            f"exoskeleton.trial_s={count / rate_hz:g}"
        )
    return placed.assign(time_s=((placed["time_s"] * rate_hz).round() - lead) / rate_hz)


def resample(rows: pd.DataFrame, rate_hz: float, samples: int, largest_gap_s: float) -> pd.DataFrame:
    """Return the rows of a trial, as of `keep`, at the machine's samples.

    Readings between two are interpolated. Commands, and how samples were taken, hold until the next one. What is
    missing holds the values before and is marked ``missed``. A `RecordingError` tells that more is missing than the
    longest stretch without samples that is bridged, s.
    """
    latest_s = float(rows.groupby("muscle", sort=False)["time_s"].min().max())
    lead = max(math.floor(-latest_s * rate_hz + A_ROUNDING), 0)
    start_s = 0.0 if lead else float(rows["time_s"].min())
    grid = np.arange(-lead, samples) / rate_hz
    muscles = rows.groupby("muscle", sort=False)
    return pd.concat([_resample_muscle(own, start_s, grid, largest_gap_s) for _, own in muscles], ignore_index=True)


def _resample_muscle(rows: pd.DataFrame, start_s: float, grid: Array, largest_gap_s: float) -> pd.DataFrame:
    readings = [name for name in (*READINGS, "reference_rad") if name in rows]
    whole = rows[readings].notna().all(axis=1)
    if whole.sum() < 2:
        raise RecordingError(
            f"expected samples of {rows['muscle'].iloc[0]} with all readings ({', '.join(readings)}), got {whole.sum()}"
        )
    rows = rows[whole]
    times = rows["time_s"].to_numpy() - start_s
    usual = float(np.median(np.diff(times)))
    before = np.clip(np.searchsorted(times, grid + 1e-9, side="right") - 1, 0, None)
    after = np.clip(np.searchsorted(times, grid - 1e-9), None, len(times) - 1)
    missed = times[after] - times[before] > A_GAP * usual
    missed |= (grid > times[-1] + 0.5 * usual) | (grid < times[0] - 0.5 * usual)
    runs = np.diff(np.flatnonzero(np.concatenate([[True], ~missed, [True]])))
    longest = (int(runs.max()) - 1) * float(grid[1] - grid[0])
    if longest > largest_gap_s:
        at = float(grid[int(np.argmax(missed))])
        raise RecordingError(
            f"column time_s: nothing for {longest:.3g} s, first from {at:.3g} s of the trial on, and "
            f"rig.largest_gap_s={largest_gap_s:g} bridges no more; record it anew, raise that, or shorten "
            "exoskeleton.trial_s"
        )
    held = rows.iloc[before].reset_index(drop=True)
    between = {name: np.interp(grid, times, rows[name].to_numpy()) for name in readings if name not in HELD}
    told = {name: np.where(missed, held[name], values) for name, values in between.items()}
    return held.assign(**told, time_s=grid, status=held["status"].mask(missed & (held["status"] == "ok"), "missed"))
