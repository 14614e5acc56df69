"""Whether numbers can be what their column says, or were recorded in another unit.

A column's values flow in; a refusal that offers the unit that would fit flows out, or nothing.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from stages.recording.columns import RecordingError, tell_rows
from stages.recording.units import known_units, own_unit

LARGE_ENOUGH = {"pressure_command_kpa": 15.0, "pressure_kpa": 15.0, "force_n": 2.0}
"""What the largest value of a column surpasses in any session that moves a muscle, in the column's unit."""


def check_plausible(values: pd.Series, name: str, low: float, high: float, unit: str | None) -> None:
    """Check a column against what any machine of this kind can show.

    Parameters
    ----------
    values : Series
        In this project's unit; its index counts the rows of the file.
    name : str
        The column.
    low, high : float
        What bounds it.
    unit : str or None
        The unit that was stated. One that is stated is believed where the values are merely small.

    Raises
    ------
    RecordingError
        Naming the rows, the bounds and the unit that would fit.
    """
    outside = (values < low) | (values > high)
    if outside.any():
        largest = values[outside].iloc[0]
        raise RecordingError(
            f"column {name}: expected {low:g} to {high:g} {own_unit(name)}, got {largest:g} in {tell_rows(outside)}; "
            f"{_offer(values, name, low, high, unit)}"
        )
    top = float(np.nanmax(np.abs(values))) if values.notna().any() else 0.0
    if unit is None and 0.0 < top < LARGE_ENOUGH.get(name, 0.0):
        offered = _offer(values, name, low, high, unit)
        raise RecordingError(
            f"column {name}: expected values in {own_unit(name)}, got none above {top:.3g} in {len(values)} rows; "
            f"{offered}, or units.{name}={own_unit(name)} if they are right"
        )


def _offer(values: pd.Series, name: str, low: float, high: float, unit: str | None) -> str:
    known = known_units(name)
    recorded = values / known[unit or own_unit(name)]
    enough = LARGE_ENOUGH.get(name, 0.0)
    fitting = [
        each
        for each, factor in known.items()
        if recorded.min() * factor >= low and enough < recorded.abs().max() * factor <= high
    ]
    return f"set units.{name}={fitting[-1]}" if fitting else "remove what is no measurement, or leave it empty"
