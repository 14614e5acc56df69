"""The clock of a recording: its rate, and every stream on one grid of samples.

Times flow in as they were recorded; they flow out as whole samples of a uniform clock. Rows that a recorder dropped
become samples without values, as no filter or simulation may take what lies beyond a gap for the next sample.
"""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from stages.science.recording.columns import RecordingError, name_rows
from stages.science.recording.units import known_units
from stages.science.signals.trajectories import Array

EPOCHS = {"ns": 1e17, "us": 1e14, "ms": 1e11}
"""By unit, from where on numbers are dates in it: those in seconds would be after the year 5000."""
DAYS = (20000.0, 80000.0)
"""Numbers that are days of a spreadsheet, which counts from the end of 1899: of the years 1954 to 2119."""
QUICK = 2e-5
"""Step of such numbers below which they are no seconds: more than 50,000 samples in one."""
MOST_EVEN = 0.8
"""Share of even steps from which numbers go on as times do."""
SAME_RATE = 0.01
"""Relative difference of two rates that are the same."""


def count_time(frame: pd.DataFrame, stream: Sequence[str], rate_hz: float) -> pd.DataFrame:
    """Return the frame with ``time_s``, which counts the samples of each stream from 0 at a rate."""
    told = [name for name in stream if name in frame]
    count = frame.groupby(told, sort=False).cumcount().to_numpy() if told else np.arange(len(frame))
    return frame.assign(time_s=count / rate_hz)


def find_epoch_unit(time: Array) -> str | None:
    """Return the unit in which numbers too large for seconds since 1970 would be dates; None where they are not."""
    latest = float(np.nanmax(np.abs(time), initial=0.0))
    return next((unit for unit, least in EPOCHS.items() if latest > least), None)


def are_days(time: Array, dated: bool) -> bool:
    """Return whether numbers are days of a spreadsheet, by size and steps; a heading may tell that they are dates."""
    steps = np.diff(time)
    within = len(steps) > 0 and DAYS[0] <= time.min() and time.max() <= DAYS[1]
    return bool(within and (dated or 0.0 < np.median(steps) < QUICK))


def goes_on(time: Array) -> bool:
    """Return whether numbers grow by even steps, but for few, as times do, which may begin anew."""
    steps = np.diff(time)
    usual = float(np.median(steps)) if len(steps) else 0.0
    return usual > 0.0 and float((np.abs(steps / usual - 1.0) < 0.5).mean()) > MOST_EVEN


def find_rate(frame: pd.DataFrame, stream: Sequence[str], stated_hz: float | None) -> float:
    """Return samples per second: as stated, if the times agree, else what the times say.

    A `RecordingError` tells time that stands still or contradicts what is stated, and offers a unit that would agree.
    """
    steps = frame.groupby(list(stream), sort=False)["time_s"].diff().dropna()
    if steps.empty:
        raise RecordingError("column time_s: expected at least two samples of something, got one of each")
    epoch = find_epoch_unit(frame["time_s"].to_numpy(dtype=float))
    if epoch is not None:
        latest = float(frame["time_s"].max())
        raise RecordingError(
            f"column time_s: expected seconds, got {latest:.4g}, later than any date; set units.time_s={epoch}"
        )
    usual = float(steps.median())
    if usual <= 0.0:
        told = "the same time again and again" if usual == 0.0 else "time that goes back; sort the rows by it"
        raise RecordingError(f"column time_s: expected time that goes on, got {told}")
    step_s = float(steps[(steps / usual - 1.0).abs() < 0.5].mean())  # a rounded clock is right on average
    if stated_hz is None:
        return float(f"{1.0 / step_s:.9g}")
    if abs(step_s * stated_hz - 1.0) > SAME_RATE:
        off = {unit: abs(step_s * factor * stated_hz - 1.0) for unit, factor in known_units("s").items()}
        units = [unit for unit in off if off[unit] < SAME_RATE]
        remedy = f"; set units.time_s={units[0]}" if units else "; correct the one or the other"
        raise RecordingError(
            f"column time_s: expected steps of {1.0 / stated_hz:.6g} s ({stated_hz:g} Hz are stated), "
            f"got {step_s:.6g} s{remedy}"
        )
    return stated_hz


def regularise(
    frame: pd.DataFrame, group: str, member: Sequence[str], rate_hz: float, largest_jitter: float
) -> tuple[pd.DataFrame, pd.Series]:
    """Return every stream on its group's uniform clock, and the time at which each group starts, s.

    Rows of a `group`, such as a trial, share a clock and a start; `member` columns, such as the muscle, tell apart its
    streams, whose rows are in the order of time. Every member in every group then has all samples, with values or
    without; ``time_s`` counts from the group's start. A `RecordingError` names the rows where a step deviates by more
    than `largest_jitter`, in periods, from whole ones, or time stands still for longer than was recorded.
    """
    stream = [group, *member]
    starts = frame.groupby(group, sort=False)["time_s"].min()
    since = (frame["time_s"] - frame[group].map(starts)) * rate_hz
    steps = since.groupby([frame[name] for name in stream], sort=False).diff().fillna(since)
    whole = steps.round()
    jittery = (steps - whole).abs() > largest_jitter * whole.clip(lower=1.0)
    jittery |= (whole < 1.0) & (steps > 0.0)
    if jittery.any():
        worst = float((steps - whole).abs().max())
        raise RecordingError(
            f"column time_s: expected steps of {1.0 / rate_hz:.6g} s within {largest_jitter:g} of it, got a deviation "
            f"of {worst:.2g} in {name_rows(jittery)}; resample it, or raise measurement.largest_jitter"
        )
    long = whole > frame.groupby(stream, sort=False)["time_s"].transform("size") + 1.0
    if long.any():
        raise RecordingError(
            f"column time_s: nothing for {whole[long].iloc[0]:.0f} samples before {name_rows(long)}, longer than what "
            f"was recorded; tell what begins there apart by {group}"
        )
    sample = whole.groupby([frame[name] for name in stream], sort=False).cumsum().astype(np.int64)
    frame = frame.drop(columns="time_s").assign(sample=sample)
    grid = (frame.groupby(group, sort=False)["sample"].max() + 1).map(np.arange).reset_index()
    if member:
        grid = grid.merge(frame[list(member)].drop_duplicates(), how="cross")
    grid = grid.explode("sample", ignore_index=True).astype({"sample": np.int64})
    filled = grid.merge(frame, how="left", on=[*stream, "sample"], sort=False)
    return filled.assign(time_s=filled.pop("sample") / rate_hz), starts
