"""Rows of a foreign file under this project's names and units, whichever of them hold a muscle.

A frame as it was read flows in, with the map of its columns and what the file says of them; a tidy frame flows out, or
a `RecordingError`. Its index counts the rows of the file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd

from stages.science.recording.columns import RecordingError, adopt
from stages.science.recording.headings import check_headings
from stages.science.recording.wide import Columns, expand, is_pattern, is_wide, lengthen


def adopt_rows(
    frame: pd.DataFrame,
    header: Sequence[str],
    told_units: Mapping[str, str],
    columns: Columns,
    units: Columns,
    names: Sequence[str],
    needed: Sequence[str],
    muscles: pd.DataFrame,
) -> pd.DataFrame:
    """Return this project's columns of a foreign frame, a row for each muscle and time where the file is wide.

    Parameters
    ----------
    frame : DataFrame
        As read, with the columns that the map names.
    header : sequence of str
        All columns of the file.
    told_units : mapping of str to str
        Units from a row of their own, by column.
    columns, units, names, needed
        As of `adopt`; a column may be a pattern with ``{muscle}`` or ``{joint}``.
    muscles : DataFrame
        With ``muscle`` and ``joint``, for which patterns stand.

    Raises
    ------
    RecordingError
        As of `adopt` and `check_headings`, and where there are no rows.
    """
    for muscle in muscles["muscle"] if is_wide(columns) else [""]:
        own = {
            name: expand(column, muscles)[muscle] if column is not None and is_pattern(column) else column
            for name, column in columns.items()
        }
        check_headings(own, units, told_units, set(header))
    if frame.empty:
        raise RecordingError("expected samples, got no rows")
    known = [*dict.fromkeys([*header, *map(str, frame.columns)])]
    if is_wide(columns):
        frame = lengthen(frame, columns, muscles)
    return adopt(frame, columns, units, names, needed, known)
