"""Whether numbers can be what their column says, or were recorded in another unit.

A column's values flow in; a refusal that offers the unit that would fit flows out, or nothing.
"""

from collections.abc import Iterable, Mapping

import numpy as np
import pandas as pd

from stages.science.recording.columns import RecordingError, name_rows
from stages.science.recording.units import known_units, own_unit
from stages.science.signals.columns import Column
from stages.science.signals.trajectories import Array

LARGE_ENOUGH = {"pressure_command_kpa": 15.0, "pressure_kpa": 15.0, "force_n": 2.0}
"""What the largest value of a column surpasses in any session that moves a muscle, in the column's unit."""

USUAL = {"pressure_command_kpa": 200.0, "pressure_kpa": 200.0, "force_n": 300.0, "contraction": 0.1}
"""Order of a column's largest values; 1 for the others."""

UNSTATED = {"kPa": (10.0, 1e5, "bar"), "m": (1e-6, 30.0, "mm"), "rad": (1e-6, 60.0, "deg")}
"""By unit: between which values the largest of a signal lies if nothing states its unit, and the likely unit else."""
FEWEST, CLEAR = 100, 0.1
"""Samples by which a muscle is judged; change of force with contraction, over its deviation, that counts."""
MOST_PULL = 25.0
"""Force over pressure times area: 3/tan^2 - 1/sin^2 of an angle of 17 degrees is 23."""
MOST_HZ, SHORTEST_S = 5e6, 1e-3
"""Samples in a second and length of a recording beyond which its times are more likely in another unit."""
FEW, SEVERAL = 0.1, 10
"""Share of rows below which those out of range are faults, not another unit; rows that may be of another column."""


def check_readings(
    samples: pd.DataFrame, names: Iterable[str], columns: Mapping[str, Column], units: Mapping[str, str | None]
) -> None:
    """Check columns, which may be missing, against what any machine of this kind can show.

    The samples are in this project's units, and the columns declare their ranges. A stated unit is believed where the
    values are merely small. A `RecordingError` names the rows, the bounds and the unit that would fit.
    """
    for name in names:
        low, high = columns[name]["low"], columns[name]["high"]
        if name not in samples or low is None or high is None:
            continue
        values, unit, own = samples[name], units.get(name), own_unit(name)
        outside = (values < low) | (values > high)
        if name == "force_n" and float(values.quantile(0.05)) < 2.0 * min(-float(values.quantile(0.95)), 0.0):
            raise RecordingError(
                f"column {name}: expected tension, which is positive, got {values.median():.4g} {own} as the middle "
                f"value; set units.{name}=-{unit or own}"
            )
        if outside.any():
            raise RecordingError(
                f"column {name}: expected {low:g} to {high:g} {own}, got {values[outside].iloc[0]:g} in "
                f"{name_rows(outside)}; {_offer(values, name, low, high, unit)}"
            )
        top = float(np.nanmax(np.abs(values))) if values.notna().any() else 0.0
        if unit is None and 0.0 < top < LARGE_ENOUGH.get(name, 0.0):
            raise RecordingError(
                f"column {name}: expected values in {own}, got none above {top:.3g} in {len(values)} rows; "
                f"{_offer(values, name, low, high, unit)}, or units.{name}={own} if they are right"
            )


def check_signals(samples: pd.DataFrame, names: Iterable[str], stated: Mapping[str, str | None]) -> None:
    """Check signals of any machine whose unit nothing states, against what machines on benches show.

    Samples are in this project's units; `stated` are the units that a person or a heading gives, by name. A
    `RecordingError` names the unit that would fit.
    """
    for name in names:
        own = own_unit(name)
        usual = UNSTATED.get(own)
        if usual is None or stated.get(name) is not None:
            continue
        low, high, other = usual
        top = float(samples[name].abs().max())
        if 0.0 < top < low or top > high:
            raise RecordingError(
                f"column {name}: expected its largest value between {low:g} and {high:g} {own}, got {top:.3g}, and no "
                f"unit is stated; set +units.{name}={other}, or +units.{name}={own} if it is right"
            )


def suspect_clock(rate_hz: float, longest_s: float) -> list[str]:
    """Return a sentence with what to look at, if hardly any recording of a machine is as quick or as short."""
    told = f"{rate_hz:.3g} samples in a second, and {longest_s:.3g} s in all, are hardly a machine's: see units.time_s"
    return [told] if rate_hz > MOST_HZ or longest_s < SHORTEST_S else []


def suspect_muscles(samples: pd.DataFrame, muscles: pd.DataFrame) -> list[str]:
    """Return what in recordings of muscles contradicts how any muscle works, in sentences with what to type.

    A muscle loses force as it shortens, at any pressure; and its braid multiplies pressure times area by no more than
    `MOST_PULL` (Chou and Hannaford 1996: at rest, with an angle of 17 degrees and more). Samples and muscles are those
    of the tables `measured` and `measured_muscles`.
    """
    growing, beyond = [], []
    for muscle in muscles.to_dict("records"):
        rows = samples[samples["muscle"] == muscle["muscle"]][["pressure_kpa", "contraction", "force_n"]].dropna()
        if len(rows) < FEWEST:
            continue
        pressure, contraction, force = (rows[name].to_numpy(dtype=float) for name in rows)
        if _slope_at_middle(pressure, contraction, force) * contraction.std() > CLEAR * force.std():
            growing.append(muscle["muscle"])
        area_mm2 = 0.25e6 * np.pi * muscle["nominal_diameter_m"] ** 2
        high = pressure > 0.5 * pressure.max()
        ratio = float(np.median(force[high] / (1e-3 * pressure[high] * area_mm2))) if high.any() else 0.0
        if ratio > MOST_PULL:
            beyond.append(f"{muscle['muscle']} ({ratio:.0f} times)")
    told = []
    if growing:
        remedy = "units.contraction=-ratio" if len(growing) == len(muscles) else "mend the columns of these alone"
        told.append(
            f"The force of {', '.join(growing)} grows as contraction does, at equal pressure, which no muscle's does: "
            f"contraction seems to have the wrong sign, or its columns are another muscle's; {remedy}."
        )
    if beyond:
        told.append(
            f"The force is more than {MOST_PULL:g} times pressure times area, which no braid brings, on "
            f"{' and '.join(beyond)}: look whether columns of muscles are swapped, and at units.force_n and "
            "units.pressure_kpa."
        )
    return told


def _slope_at_middle(pressure: Array, contraction: Array, force: Array) -> float:
    """Return how force changes with contraction at the mean pressure, by least squares; 0 where that is not told."""
    p, c = pressure - pressure.mean(), contraction - contraction.mean()
    if min(p.std(), c.std()) <= 0.0:
        return 0.0
    columns = np.stack([np.ones_like(p), p / p.std(), c / c.std(), p * c / (p.std() * c.std())], axis=1)
    found, _, rank, _ = np.linalg.lstsq(columns, force, rcond=1e-6)
    told = rank == columns.shape[1] and np.var(force - columns @ found) < 0.5 * force.var()
    return float(found[2] / c.std()) if told else 0.0


def _offer(values: pd.Series, name: str, low: float, high: float, unit: str | None) -> str:
    known = known_units(name)
    top = values.abs().quantile(0.95) / known[unit or own_unit(name)]
    fitting = {each: top * factor for each, factor in known.items() if low <= top * factor <= high}
    inside = values.between(low, high) | values.isna()
    mostly_right = inside.mean() > 1.0 - FEW and values.abs().quantile(0.95) >= LARGE_ENOUGH.get(name, 0.0)
    if mostly_right or not fitting:
        several = (~inside).sum() >= SEVERAL
        other = f"; if its column is another's, set columns.{name}=COLUMN" if several else ""
        return f"remove what is no measurement, or leave it empty{other}"
    nearest = min(fitting, key=lambda each: abs(np.log(fitting[each] / USUAL.get(name, 1.0))))
    return f"set units.{name}={nearest}"
