"""Recorded columns under this project's names: found, read as numbers, converted, and each row named once.

A frame as it was read flows in, with the map of columns and units; a frame of this project's columns flows out, whose
index counts the rows of the file. Every refusal names the column and the rows, counted from 0.
"""

import re
import shlex
from collections.abc import Mapping, Sequence
from difflib import get_close_matches

import numpy as np
import pandas as pd

from stages.science.recording.dates import read_dates
from stages.science.recording.units import choose_unit, convert

SHOWN_ROWS = 3
MARKS = (-99.0, -999.0, -9999.0, -99999.0, 999.0, 9999.0, 99999.0, -32768.0, 32767.0, 65535.0)
"""Numbers that loggers write where nothing was read."""
FEWEST_VALUES = 10
"""Different readings beside a mark, from which it is seen how far it is from all of them."""
TIME = "time_s"
COUNTED = ", or set measurement.rate_hz (Hz) where no column is time"
ANOTHER = "; of another machine, set measurement=records: python -m pipeline.columns FILE prints the command"
ELSE = {TIME: COUNTED, "trial": ANOTHER, "muscle": ANOTHER}
"""What may be meant where a column is not there."""
LEAVE_EMPTY = "leave empty in the file what was not read"
MOST_WORDS = 0.1
"""Share of values that are no numbers up to which a column is one of numbers."""


class RecordingError(ValueError):
    """A recording does not hold what it should; the message fits on one line and names column and rows."""


def name_rows(wrong: pd.Series) -> str:
    """Return the first rows at which a mask is true, and how many more there are."""
    rows = list(dict.fromkeys(str(index) for index in wrong.index[wrong.to_numpy(dtype=bool)]))
    more = f" and {len(rows) - SHOWN_ROWS} more" if len(rows) > SHOWN_ROWS else ""
    return f"row{'s' * (len(rows) > 1)} {', '.join(rows[:SHOWN_ROWS])}{more}"


def quote(value: str) -> str:
    """Return a text as the value of an override that stays a text."""
    plain = re.fullmatch(r"[A-Za-z_/][\w./-]*", value, re.ASCII)
    if plain and value.lower() not in ("null", "true", "false", "nan", "inf"):
        return value
    return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'


def assign(key: str, value: str) -> str:
    """Return an override as it is typed, whose value stays a text."""
    return shlex.quote(f"{key}={quote(value)}")


def adopt(
    frame: pd.DataFrame,
    columns: Mapping[str, str | None],
    units: Mapping[str, str | None],
    names: Sequence[str],
    needed: Sequence[str],
    header: Sequence[str] = (),
) -> pd.DataFrame:
    """Return the columns of this project that a recorded frame has, as numbers in this project's units.

    By this project's name, `columns` and `units` give the file's column, by default one of the same name, and its
    unit, by default the name's own. The values of `names` are text; `needed` columns must be there, others of `columns`
    are taken where they are. The file's header is for messages, where the frame holds some of its columns only. A
    `RecordingError` tells a column that is missing or holds something else than numbers, or an unknown unit.
    """
    found = {}
    there = list(header) or [str(each) for each in frame.columns]
    for name in columns:
        source = columns[name] or name
        if source in frame:
            found[name] = _spell(frame[source]) if name in names else _convert(frame[source], name, units)
        elif columns[name] is not None:
            raise RecordingError(f"no column '{source}', which columns.{name} names; {_offer(source, there)}")
        elif name in needed:
            remedy = f"say which with columns.{name}=NAME{ELSE.get(name, '')}"
            raise RecordingError(f"no column {name}; {_offer(name, there)}; {remedy}")
    for name in names:
        source = columns.get(name) or name
        if name in found and frame[source].isna().any():
            raise RecordingError(f"column {source}: expected text, got nothing in {name_rows(frame[source].isna())}")
    return pd.DataFrame(found)


def _spell(values: pd.Series) -> pd.Series:
    """Return values as names: whole numbers without a point."""
    whole = values.dtype.kind == "f" and bool((values.dropna() % 1.0 == 0.0).all())
    return values.astype("Int64").astype(str) if whole else values.astype(str)


def check_rows(frame: pd.DataFrame, key: Sequence[str]) -> None:
    """Check that each row is named once by its key, the columns that name a stream and then the time, which goes on.

    A `RecordingError` names the rows that have no time, repeat another or go back in time.
    """
    *stream, time = key
    anew = f", or tell what begins anew there apart: set columns.{stream[0]}=NAME" if stream else ""
    for name in key:
        empty = frame[name].isna()
        if empty.any():
            raise RecordingError(f"column {name}: expected a value in every row, got none in {name_rows(empty)}")
    repeated = frame.duplicated(list(key))
    if repeated.any():
        verb = "repeat" if repeated.sum() > 1 else "repeats"
        told = f"{verb} an earlier one ({_describe_first(frame, repeated, key)}); remove them{anew}"
        raise RecordingError(f"column {time}: {name_rows(repeated)} {told}")
    back = (frame.groupby(stream, sort=False)[time].diff() if stream else frame[time].diff()) < 0.0
    if back.any():
        where = f" ({_describe_first(frame, back, stream)})" if stream else ""
        raise RecordingError(f"column {time}: time goes back in {name_rows(back)}{where}; sort the rows{anew}")


def _describe_first(frame: pd.DataFrame, wrong: pd.Series, names: Sequence[str]) -> str:
    first = frame.loc[wrong, list(names)].iloc[0]
    return ", ".join(f"{name} {each if isinstance(each, str) else f'{each:.9g}'}" for name, each in first.items())


def _convert(values: pd.Series, name: str, units: Mapping[str, str | None]) -> pd.Series:
    try:
        unit = choose_unit(name, units.get(name))
    except ValueError as error:
        raise RecordingError(str(error)) from None
    try:
        passed = read_dates(values) if name == TIME else None
    except ValueError as error:
        raise RecordingError(f"column {values.name}: {error}") from None
    if passed is not None:
        return passed
    numbers, wrong = find_words(values)
    if wrong.any():
        first = values[wrong].iloc[0]
        expected = "numbers or dates, as 2026-06-05 10:00:00," if name == TIME else "numbers,"
        told = f"expected {expected} got {str(first)[:40]!r} in {name_rows(wrong)}"
        told += f"; {LEAVE_EMPTY}" if name != TIME and wrong.mean() <= MOST_WORDS else ""
        raise RecordingError(f"column {values.name}: {told}")
    numbers = numbers.astype(float)
    infinite = numbers.abs() == np.inf
    if infinite.any():
        raise RecordingError(f"column {values.name}: expected finite numbers, got inf in {name_rows(infinite)}")
    told = find_mark(numbers)
    if told:
        raise RecordingError(f"column {values.name}: {told}; {LEAVE_EMPTY}")
    return convert(numbers, name, unit)


def find_words(values: pd.Series) -> tuple[pd.Series, pd.Series]:
    """Return a column as numbers, missing where it holds something else, and where that is so."""
    numbers = values if values.dtype.kind in "fiu" else pd.to_numeric(values, errors="coerce")
    return numbers, values.notna() & (numbers.isna() | (values.dtype.kind in "mM"))


def find_mark(values: pd.Series, least: int = 2) -> str:
    """Return that numbers hold one of the `MARKS`, so often and far from all readings; empty if they do not."""
    for mark in MARKS:
        marked = values == mark
        rest = values[~marked].dropna()
        if marked.sum() < least or rest.nunique() < FEWEST_VALUES:
            continue
        low, high = float(rest.min()), float(rest.max())
        if max(low - mark, mark - high) > high - low:
            told = f"{marked.sum()} values are" if marked.sum() > 1 else "one value is"
            return f"{told} {mark:g}, far from all readings ({low:.4g} to {high:.4g})"
    return ""


def _offer(name: str, known: Sequence[str]) -> str:
    near = get_close_matches(name, known, n=1)
    return f"did you mean '{near[0]}'?" if near else f"there are: {', '.join(known)}"
