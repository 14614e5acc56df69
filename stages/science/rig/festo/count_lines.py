"""What counts mean: judged points flow in, a line for each channel flows out, or why there is none.

A value is the sign times the value of one count times the counts beyond zero, so a line is fitted to counts over known
values; its residuals are told in the values' unit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from stages.science.rig.festo.channels import COUNTER_SPAN, CountRange, EncoderPlace, ForcePlace, PressurePlace
from stages.science.rig.festo.known_points import UNITS, CalibrationSettings, split_name
from stages.science.signals.trajectories import Array

AnyPlace = PressurePlace | ForcePlace | EncoderPlace

LEAST_COUNTS = 3.0
"""Counts by which points differ at least where a channel follows them."""
FOLLOWS = 0.9
"""Correlation with the points of another channel, from which on a channel is taken to follow them."""


@dataclass(frozen=True)
class Judged:
    """A record of one channel at one point.

    Parameters
    ----------
    count, spread_count, drift_count : float
        Mean, standard deviation, and change from the first to the last quarter; of whole counts.
    samples : int
        How many were taken.
    saturated, lost : float
        Share of samples at the end of the range, and without a value.
    problem : str
        Why the point is of no use; empty where it is.
    """

    count: float
    spread_count: float
    drift_count: float
    samples: int
    saturated: float
    lost: float
    problem: str


def judge_point(
    counts: Array, kind: str, place: AnyPlace, valid: CountRange, settings: CalibrationSettings, stopped: str = ""
) -> Judged:
    """Judge what a channel counted at one point.

    Parameters
    ----------
    counts : (T,) ndarray
        Of the channel.
    kind : str
        Of the channel.
    place : PressurePlace, ForcePlace or EncoderPlace
        As configured.
    valid : CountRange
        Which counts of an analogue input are values.
    settings : CalibrationSettings
        How still it has to be.
    stopped : str
        Why the record ended early.
    """
    lost = saturated = np.zeros(len(counts), dtype=bool)
    if kind in ("pressure", "force"):
        lost = np.isin(counts, valid.none)
        saturated = ~lost & ((counts < valid.low) | (counts >= valid.high))
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
    return Judged(
        float(counts.mean()),
        float(counts.std()),
        drift,
        len(counts),
        float(saturated.mean()),
        float(lost.mean()),
        problem,
    )


def unroll(counts: Array, near: float) -> Array:
    """Return a counter's counts without its beginning anew, as near to a count as they can be."""
    turned: Array = near + (counts - near + COUNTER_SPAN / 2) % COUNTER_SPAN - COUNTER_SPAN / 2
    return turned


@dataclass(frozen=True)
class Line:
    """What a channel's counts mean, or why that is not known.

    Parameters
    ----------
    status : str
        ``calibrated``, or ``refused`` where the points determine no line.
    per_count, zero_count : float
        Value of one count, and counts at zero.
    sign : int
        -1 where counts fall as the value rises.
    residual_rms, residual_largest : float
        Of the points, in the unit of the channel.
    repeatability : float
        Largest difference between points of the same known value; nan where none was repeated.
    points : int
        Those that were of use.
    plausible : bool
        Whether it is near what is configured.
    told : str
        Why it was refused, or what is strange.
    """

    status: str
    per_count: float
    zero_count: float
    sign: int
    residual_rms: float
    residual_largest: float
    repeatability: float
    points: int
    plausible: bool
    told: str

    def as_row(self) -> dict[str, Any]:
        """Return the fields by name."""
        return {each.name: getattr(self, each.name) for each in fields(self)}


def fit_line(
    channel: str,
    known: Array,
    count: Array,
    spread_count: Array,
    problems: Sequence[str],
    place: AnyPlace,
    valid: CountRange,
    settings: CalibrationSettings,
    followers: Sequence[str] = (),
) -> Line:
    """Fit the line of one channel, or refuse to.

    Parameters
    ----------
    channel : str
        Its name.
    known, count, spread_count : (P,) ndarray
        Known values, in the channel's unit, and mean and spread of the counts at them.
    problems : sequence of str
        What makes a point useless; empty where it is of use.
    place : PressurePlace, ForcePlace or EncoderPlace
        As configured.
    valid : CountRange
        Which counts of an analogue input are values.
    settings : CalibrationSettings
        Tolerances.
    followers : sequence of str
        Channels of the same kind that follow these points, as of `find_followers`.
    """
    unit, tolerance = UNITS[split_name(channel)[1]], settings.residual.of(split_name(channel)[1])
    used = np.array([not each for each in problems], dtype=bool)
    value, counts = known[used], count[used]
    swapped = f"; {' and '.join(followers)} follows them: are cables swapped?" if followers else ""
    if len(np.unique(value)) < 2:
        useless = [each for each in problems if each]
        why = f", as {useless[0]}" if useless else ""
        got = f"expected points of use at two known values at least, got {len(np.unique(value))} of {len(known)}"
        return refuse(f"{got}{why}{swapped}", int(used.sum()))
    least = max(LEAST_COUNTS, settings.spacing * float(np.median(spread_count[used])))
    if np.ptp(counts) < least:
        what = f"the counts are the same at all points ({counts.min():.1f} to {counts.max():.1f})"
        return refuse(f"{what}{swapped or '; is the channel dead?'}", int(used.sum()))
    slope, zero = np.polyfit(value, counts, 1)
    left = (counts - zero - slope * value) / slope
    largest = float(np.abs(left).max())
    rms = float(np.sqrt(np.mean(left**2)))
    if largest > tolerance:
        furthest = value[np.abs(left).argmax()]
        what = f"the point at {furthest:g} {unit} lies {largest:.3g} {unit} from the line, {tolerance:g} are permitted"
        return refuse(f"{what}{swapped}", int(used.sum()), rms, largest)
    sign, per_count = (1 if slope > 0 else -1), float(1.0 / abs(slope))
    strange = find_strange(per_count, float(zero), sign, place, valid, settings, analogue=unit != "rad")
    return Line(
        "calibrated",
        per_count,
        float(zero),
        sign,
        rms,
        largest,
        measure_repeatability(value, counts * per_count),
        int(used.sum()),
        not strange,
        "; ".join(strange),
    )


def refuse(why: str, points: int, rms: float = np.nan, largest: float = np.nan) -> Line:
    """Return what stands for a line that the points do not determine."""
    return Line("refused", np.nan, np.nan, 0, rms, largest, np.nan, points, False, why)


def find_strange(
    per_count: float,
    zero_count: float,
    sign: int,
    place: AnyPlace,
    valid: CountRange,
    settings: CalibrationSettings,
    analogue: bool,
) -> list[str]:
    """Say in what a line is far from what is configured."""
    strange = []
    ratio = per_count / abs(place.per_count)
    if sign != place.sign:
        strange.append(f"the sign is {sign}, configured {place.sign}")
    if not 1.0 / settings.plausible_ratio <= ratio <= settings.plausible_ratio:
        strange.append(f"a count is worth {ratio:.3g} times what is configured")
    if analogue and not valid.low <= zero_count < valid.high:
        strange.append(f"zero at count {zero_count:.0f} lies out of the range {valid.low} to {valid.high}")
    return strange


def measure_repeatability(value: Array, measured: Array) -> float:
    """Return the largest difference between what was measured at the same known value; nan where none was repeated."""
    spans = [np.ptp(measured[value == each]) for each in np.unique(value) if (value == each).sum() > 1]
    return float(max(spans)) if spans else float("nan")


def find_followers(
    channel: str, values: Array, means: Mapping[str, Array], noise: Mapping[str, float], settings: CalibrationSettings
) -> list[str]:
    """Return the channels of the same kind that follow the points of another one.

    Parameters
    ----------
    channel : str
        Whose points they are; of a regulator, pressure sensors are looked at.
    values : (P,) ndarray
        What was set.
    means : mapping of str to (P,) ndarray
        Mean counts of every input at these points.
    noise : mapping of str to float
        Spread of each input within a record, counts.
    settings : CalibrationSettings
        How many spreads the counts have to differ by.
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
