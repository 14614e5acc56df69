"""Whether numbers can be what their column says, or were recorded in another unit.

A column's values flow in; a refusal that offers the unit that would fit flows out, or nothing.
"""

from collections.abc import Iterable, Mapping

import numpy as np
import pandas as pd
import pandera.pandas as pa

from stages.science.recording.columns import RecordingError, name_rows
from stages.science.recording.units import known_units, own_unit

LARGE_ENOUGH = {"pressure_command_kpa": 15.0, "pressure_kpa": 15.0, "force_n": 2.0}
"""What the largest value of a column surpasses in any session that moves a muscle, in the column's unit."""

USUAL = {"pressure_command_kpa": 200.0, "pressure_kpa": 200.0, "force_n": 300.0, "contraction": 0.1}
"""Order of a column's largest values; 1 for the others."""

FEW = 0.1
"""Share of the rows below which those out of range are faults, not another unit."""


def check_readings(
    samples: pd.DataFrame, names: Iterable[str], columns: Mapping[str, pa.Column], units: Mapping[str, str | None]
) -> None:
    """Check columns, which may be missing, against what any machine of this kind can show.

    The samples are in this project's units, and the columns declare their ranges. A stated unit is believed where the
    values are merely small. A `RecordingError` names the rows, the bounds and the unit that would fit.
    """
    for name in names:
        if name not in samples:
            continue
        values, unit, own = samples[name], units.get(name), own_unit(name)
        least, most = (check.statistics for check in columns[name].checks)
        low, high = least["min_value"], most["max_value"]
        outside = (values < low) | (values > high)
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


def _offer(values: pd.Series, name: str, low: float, high: float, unit: str | None) -> str:
    known = known_units(name)
    top = values.abs().quantile(0.95) / known[unit or own_unit(name)]
    fitting = {each: top * factor for each, factor in known.items() if low <= top * factor <= high}
    inside = values.between(low, high) | values.isna()
    mostly_right = inside.mean() > 1.0 - FEW and values.abs().quantile(0.95) >= LARGE_ENOUGH.get(name, 0.0)
    if mostly_right or not fitting:
        return "remove what is no measurement, or leave it empty"
    nearest = min(fitting, key=lambda each: abs(np.log(fitting[each] / USUAL.get(name, 1.0))))
    return f"set units.{name}={nearest}"
