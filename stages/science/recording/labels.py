"""Which column of a recorded file tells its records apart: one that stays as it is until time begins anew.

Columns flow in, with the one that is time; those that label records flow out. Names say less than values do: a column
``Nr`` may count records or rows.
"""

import re
from collections.abc import Mapping

import numpy as np
import pandas as pd

from stages.science.recording.dates import is_dates, read_dates

FIELD = re.compile(r"\.[A-Za-z].*")
"""Field behind the name of an array of structs; a number there counts repeated column names instead."""
PAUSE = 10.0
"""Usual steps of time from which one is a pause between records."""
FEWEST_ROWS = 2.0
"""Smallest mean number of rows per record; a column whose values change more often counts rows."""


def list_labels(columns: Mapping[str, pd.Series], time: str | None) -> list[str]:
    """Return the columns that label records by their values.

    They are numbers or text, each of them in rows that follow each other, and change wherever time goes back
    or, if it never does, goes on behind a pause; those that are not whole change nowhere else.
    The number of an array of structs, which has the array's name, is one whatever time does.
    A text is also one where rows of records take turns: with it no time comes twice, and without it most do.
    """
    arrays = [name for name in columns if any(FIELD.fullmatch(each.removeprefix(name)) for each in columns)]
    if time is None:
        return arrays
    if columns[time].is_monotonic_increasing and columns[time].duplicated(keep=False).mean() > 0.5:
        return arrays + [name for name in columns if name != time and _takes_turns(columns[name], columns[time])]
    back = _find_restarts(columns[time])
    if not back:
        return arrays
    others = {name: values for name, values in columns.items() if name not in (time, *arrays)}
    size = len(columns[time])
    return arrays + [name for name, values in others.items() if len(values) == size and _labels(values, back)]


def _takes_turns(values: pd.Series, time: pd.Series) -> bool:
    """Return whether a text tells apart the rows of one time."""
    text = len(values) == len(time) and values.dtype.kind not in "fiubmM" and not values.isna().any()
    return text and not is_dates(values) and not pd.DataFrame({"its": values, "at": time}).duplicated().any()


def stays(values: pd.Series) -> bool:
    """Return whether values stay the same over rows, as labels do."""
    return not values.isna().any() and (len(_find_changes(values)) + 1) * FEWEST_ROWS <= len(values)


def restarts(columns: Mapping[str, pd.Series], time: str, part: str) -> bool:
    """Return whether time goes back elsewhere than where another part begins."""
    return bool(_find_restarts(columns[time]) - _find_changes(columns[part]))


def _labels(values: pd.Series, back: set[int]) -> bool:
    whole = values.dtype.kind in "iub" or (values.dtype.kind == "f" and bool((values % 1.0 == 0.0).all()))
    if not stays(values) or values.dtype.kind in "mM" or (values.dtype.kind not in "fiub" and is_dates(values)):
        return False
    changes = _find_changes(values)
    if values.dtype.kind == "f" and not whole and changes != back:  # what is measured may rest elsewhere
        return False
    return values.nunique() == len(changes) + 1 and back <= changes


def _find_changes(values: pd.Series) -> set[int]:
    return set((np.flatnonzero((values != values.shift()).to_numpy()[1:]) + 1).tolist())


def _find_restarts(time: pd.Series) -> set[int]:
    """Return the rows in which time is less than in the one before; if it never is, those behind a pause."""
    try:
        passed = time if time.dtype.kind in "fiu" else read_dates(time)
    except ValueError:
        passed = None
    if passed is None:
        return set()
    steps = passed.diff()
    begins = steps < 0.0 if (steps < 0.0).any() else steps > PAUSE * steps.median()
    return set(np.flatnonzero(begins.to_numpy()).tolist())
