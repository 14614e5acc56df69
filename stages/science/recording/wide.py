"""Files with a column for each muscle or joint: patterns such as ``force_{muscle}`` name them.

A frame as it was read flows in, with the map of its columns; a frame with a row for each muscle and time flows out, in
which each pattern is the name of one column, so that the map goes on to hold.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

import pandas as pd

MUSCLE, JOINT = "{muscle}", "{joint}"

Columns = Mapping[str, str | None]


def is_wide(columns: Columns) -> bool:
    """Return whether some column of a map is a pattern."""
    return any(map(is_pattern, columns.values()))


def is_pattern(column: str | None) -> bool:
    """Return whether a name stands for a column of each muscle or joint."""
    return column is not None and (MUSCLE in column or JOINT in column)


def expand(column: str, muscles: pd.DataFrame) -> dict[str, str]:
    """Return for each muscle the column that a pattern stands for.

    Parameters
    ----------
    column : str
        The pattern.
    muscles : DataFrame
        With ``muscle`` and ``joint``.
    """
    pairs = zip(muscles["muscle"], muscles["joint"], strict=True)
    return {muscle: column.replace(MUSCLE, muscle).replace(JOINT, joint) for muscle, joint in pairs}


def list_sources(columns: Iterable[str], muscles: pd.DataFrame) -> list[str]:
    """Return columns, and in the place of each pattern all that it stands for."""
    told = [list(expand(each, muscles).values()) if is_pattern(each) else [each] for each in columns]
    return list(dict.fromkeys(name for each in told for name in each))


def is_one_trial(columns: Columns, names: Collection[str]) -> bool:
    """Return whether a file with these columns is one trial, as it is wide and nothing in it numbers trials."""
    return is_wide(columns) and "trial" in columns and columns["trial"] is None and "trial" not in names


def lengthen(frame: pd.DataFrame, columns: Columns, muscles: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of every muscle behind each other; a file that has no column of trials is one trial.

    Parameters
    ----------
    frame : DataFrame
        As read, with the columns that `list_sources` lists, as far as there are such.
    columns : mapping of str to str or None
        The map, with patterns.
    muscles : DataFrame
        With ``muscle`` and ``joint``.

    Returns
    -------
    DataFrame
        Under the names that the map has, the muscle's beside them; its index counts the rows of the file.
    """
    patterns = [each for each in columns.values() if each is not None and is_pattern(each)]
    spent = set(list_sources(patterns, muscles))
    shared = frame[[name for name in frame if name not in spent]]
    if is_one_trial(columns, list(map(str, frame))):
        shared = shared.assign(trial=0)
    long = []
    for muscle in muscles["muscle"]:
        own = {each: expand(each, muscles)[muscle] for each in patterns}
        told = {each: frame[source] for each, source in own.items() if source in frame}
        long.append(shared.assign(**{columns.get("muscle") or "muscle": muscle}, **told))
    return pd.concat(long)
