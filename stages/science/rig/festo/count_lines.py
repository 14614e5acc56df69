"""What counts mean: judged points flow in, a line for each channel flows out, or why there is none.

A value is the sign times the value of one count times the counts beyond zero, so a line is fitted to counts over known
values; its residuals are told in the values' unit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from stages.science.rig.festo.channels import COUNTER_SPAN, CountRange, Place
from stages.science.rig.festo.known_points import UNITS, CalibrationSettings, split_name
from stages.science.signals.trajectories import Array

LEAST_COUNTS = 3.0
"""Counts by which points differ at least where a channel follows them."""
FOLLOWS = 0.9
"""Correlation with the points of another channel, from which on a channel is taken to follow them."""


@dataclass(frozen=True)
class Judged:
    """A record of one channel at one point, as the columns of the table `calibration_points` say."""

    count: float
    spread_count: float
    drift_count: float
    samples: int
    saturated: float
    lost: float
    problem: str


def judge_point(
    counts: Array, kind: str, place: Place, valid: CountRange, settings: CalibrationSettings, stopped: str = ""
) -> Judged:
    """Judge what a channel counted at one point (T,), by its configured place; `stopped` is why it ended early."""
    lost = saturated = np.zeros(len(counts), dtype=bool)
    if kind in ("pressure", "force"):
        lost, saturated = valid.sort_out(counts)
    if kind == "encoder":
        counts = unroll(counts, place.zero_count)
    if not len(counts):
        return Judged(np.nan, np.nan, np.nan, 0, 0.0, 0.0, stopped or "nothing was recorded")
    quarter = max(len(counts) // 4, 1)
    drift = float(counts[-quarter:].mean() - counts[:quarter].mean())
    moved = abs(drift * place.per_count)
    problem = stopped
    if not problem and lost.any():
        problem = f"the channel told no value (count {counts[lost][0]:.0f})"
    if not problem and saturated.any():
        problem = f"the channel was at its end (count {counts[saturated][0]:.0f}, range {valid.low} to {valid.high})"
    if not problem and moved > settings.still.of(kind):
        problem = f"it changed by {moved:.3g} {UNITS[kind]} meanwhile, {settings.still.of(kind):g} are permitted"
    mean, spread = float(counts.mean()), float(counts.std())
    return Judged(mean, spread, drift, len(counts), float(saturated.mean()), float(lost.mean()), problem)


def unroll(counts: Array, near: float) -> Array:
    """Return a counter's counts without its beginning anew, as near to a count as they can be."""
    return np.asarray(near + (counts - near + COUNTER_SPAN / 2) % COUNTER_SPAN - COUNTER_SPAN / 2)


@dataclass(frozen=True)
class Line:
    """What a channel's counts mean, as the columns of the tables `calibration_lines` and `calibration_changes` say.

    By default it is one that the points do not determine.
    """

    told: str
    points: int
    residual_rms: float = np.nan
    residual_largest: float = np.nan
    status: str = "refused"
    per_count: float = np.nan
    zero_count: float = np.nan
    sign: int = 0
    repeatability: float = np.nan
    plausible: bool = False


def fit_line(
    channel: str,
    points: pd.DataFrame,
    place: Place,
    valid: CountRange,
    settings: CalibrationSettings,
    followers: Sequence[str] = (),
) -> Line:
    """Fit the line of one channel through points, or refuse to.

    The points are rows of the table `calibration_points`: known values in the channel's unit, mean and spread of the
    counts at them, and what makes a point useless, empty where it is of use. Followers are as of `find_followers`.
    """
    kind = split_name(channel)[1]
    unit, tolerance = UNITS[kind], settings.residual.of(kind)
    used = points[(points["problem"] == "") & points["known"].notna()]  # a point taken again has no known value
    value, counts = used["known"].to_numpy(), used["count"].to_numpy()
    swapped = f"; {' and '.join(followers)} follows them: are cables swapped?" if followers else ""
    if len(np.unique(value)) < 2:
        useless = list(points["problem"][points["problem"] != ""])
        why = f", as {useless[0]}" if useless else ""
        got = f"expected points of use at two known values at least, got {len(np.unique(value))} of {len(points)}"
        return Line(f"{got}{why}{swapped}", len(value))
    least = max(LEAST_COUNTS, settings.spacing * float(np.median(used["spread_count"])))
    if np.ptp(counts) < least:
        what = f"the counts are the same at all points ({counts.min():.1f} to {counts.max():.1f})"
        return Line(f"{what}{swapped or '; is the channel dead?'}", len(value))
    slope, zero = np.polyfit(value, counts, 1)
    left = (counts - zero - slope * value) / slope
    largest = float(np.abs(left).max())
    rms = float(np.sqrt(np.mean(left**2)))
    if largest > tolerance:
        furthest = value[np.abs(left).argmax()]
        what = f"the point at {furthest:g} {unit} lies {largest:.3g} {unit} from the line, {tolerance:g} are permitted"
        return Line(f"{what}{swapped}", len(value), rms, largest)
    sign, per_count = (1 if slope > 0 else -1), float(1.0 / abs(slope))
    strange = []
    ratio = per_count / abs(place.per_count)
    if sign != place.sign:
        strange.append(f"the sign is {sign}, configured {place.sign}")
    if not 1.0 / settings.plausible_ratio <= ratio <= settings.plausible_ratio:
        strange.append(f"a count is worth {ratio:.3g} times what is configured")
    if unit != "rad" and not valid.low <= zero < valid.high:
        strange.append(f"zero at count {zero:.0f} lies out of the range {valid.low} to {valid.high}")
    spans = [np.ptp(counts[value == each] * per_count) for each in np.unique(value) if (value == each).sum() > 1]
    told, repeatability = "; ".join(strange), float(max(spans, default=np.nan))
    return Line(told, len(value), rms, largest, "calibrated", per_count, float(zero), sign, repeatability, not strange)


def find_followers(
    channel: str, values: Array, means: Mapping[str, Array], noise: Mapping[str, float], settings: CalibrationSettings
) -> list[str]:
    """Return the channels of the same kind that follow the points of another one; of a regulator, pressure sensors.

    Values (P,) were set at the points; of every input are known the mean counts there (P,) and their spread.
    """
    owner, kind = split_name(channel)
    kind, own = ("pressure", f"{owner}.pressure") if kind == "command" else (kind, channel)
    found = []
    for name, counts in means.items():
        if name == own or split_name(name)[1] != kind or np.ptp(values) == 0.0 or not np.isfinite(counts).all():
            continue
        if np.ptp(counts) < max(LEAST_COUNTS, settings.spacing * noise[name]):
            continue
        if abs(np.corrcoef(values, counts)[0, 1]) > FOLLOWS:
            found.append(name)
    return found
