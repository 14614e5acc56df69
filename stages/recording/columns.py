"""Foreign columns under this project's names: found, read as numbers, converted, and each row named once.

A frame as it was read flows in, with the map of columns and units; a frame of this project's columns flows out, whose
index counts the rows of the file. Every refusal names the column and the rows, counted from 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from difflib import get_close_matches

import numpy as np
import pandas as pd

from stages.recording.units import known_units, own_unit

SHOWN_ROWS = 3


class RecordingError(ValueError):
    """A recording does not hold what it should; the message fits on one line and names column and rows."""


def tell_rows(wrong: pd.Series) -> str:
    """Return the first rows at which a mask is true, and how many more there are."""
    rows = [str(index) for index in wrong.index[wrong.to_numpy(dtype=bool)]]
    more = f" and {len(rows) - SHOWN_ROWS} more" if len(rows) > SHOWN_ROWS else ""
    return f"row{'s' * (len(rows) > 1)} {', '.join(rows[:SHOWN_ROWS])}{more}"


def adopt(
    frame: pd.DataFrame,
    columns: Mapping[str, str | None],
    units: Mapping[str, str | None],
    names: Sequence[str],
    needed: Sequence[str],
) -> pd.DataFrame:
    """Return the columns of this project that a foreign frame has, as numbers in this project's units.

    Parameters
    ----------
    frame : DataFrame
        As read; each row has its number.
    columns : mapping of str to str or None
        Of this project's columns, the foreign one that holds it; one of the same name where there is none.
    units : mapping of str to str or None
        Of this project's columns, the unit in which it is recorded; its own where there is none.
    names : sequence of str
        Columns that are wanted, whose values are text.
    needed : sequence of str
        Columns that must be there; those of `columns` that are neither are taken where they are.

    Raises
    ------
    RecordingError
        For a column that is missing or holds something else than numbers, and for a unit that is unknown.
    """
    found = {}
    for name in columns:
        source = columns[name] or name
        if source in frame:
            found[name] = frame[source].astype(str) if name in names else _convert(frame[source], name, units)
        elif columns[name] is not None:
            raise RecordingError(f"no column '{source}', which columns.{name} names; {_offer(source, frame)}")
        elif name in needed:
            raise RecordingError(f"no column {name}; {_offer(name, frame)}; say which with columns.{name}=NAME")
    for name in names:
        source = columns.get(name) or name
        if name in found and frame[source].isna().any():
            raise RecordingError(f"column {source}: expected text, got nothing in {tell_rows(frame[source].isna())}")
    return pd.DataFrame(found)


def check_rows(frame: pd.DataFrame, key: Sequence[str]) -> None:
    """Check that each row is named once and that time goes on.

    Parameters
    ----------
    frame : DataFrame
        From `adopt`.
    key : sequence of str
        Columns that name a stream of samples, then the time.

    Raises
    ------
    RecordingError
        Naming the rows that have no time, repeat another or go back in time.
    """
    *stream, time = key
    for name in key:
        if frame[name].isna().any():
            raise RecordingError(f"column {name}: expected a value in every row, got none in {_rows(frame[name])}")
    repeated = frame.duplicated(list(key))
    if repeated.any():
        told = ", ".join(f"{name} {frame.loc[repeated, name].iloc[0]}" for name in key)
        raise RecordingError(f"column {time}: {tell_rows(repeated)} repeat an earlier one ({told}); remove them")
    steps = frame.groupby(stream, sort=False)[time].diff() if stream else frame[time].diff()
    if (steps < 0.0).any():
        raise RecordingError(
            f"column {time}: time goes back in {tell_rows(steps < 0.0)}; sort the rows"
            + (f", or tell what begins there apart by {' and '.join(stream)}" if stream else "")
        )


def _convert(values: pd.Series, name: str, units: Mapping[str, str | None]) -> pd.Series:
    unit = units.get(name) or own_unit(name)
    known = known_units(name)
    if unit not in known:
        raise RecordingError(f"units.{name}: no unit '{unit}'; choose from: {', '.join(known)}")
    numbers = values if values.dtype.kind in "fiu" else pd.to_numeric(values, errors="coerce")
    wrong = numbers.isna() & values.notna()
    if wrong.any():
        first = values[wrong].iloc[0]
        raise RecordingError(f"column {values.name}: expected numbers, got {str(first)[:40]!r} in {tell_rows(wrong)}")
    numbers = numbers.astype(float)
    infinite = numbers.abs() == np.inf
    if infinite.any():
        raise RecordingError(f"column {values.name}: expected finite numbers, got inf in {tell_rows(infinite)}")
    return numbers * known[unit]


def _rows(values: pd.Series) -> str:
    return tell_rows(values.isna())


def _offer(name: str, frame: pd.DataFrame) -> str:
    known = [str(each) for each in frame.columns]
    near = get_close_matches(name, known, n=1)
    return f"did you mean '{near[0]}'?" if near else f"there are: {', '.join(known)}"
