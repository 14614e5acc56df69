"""Columns of measurements: what is in each, its unit, and the range of what can be."""

from collections.abc import Collection
from typing import Any, TypedDict


class Column(TypedDict):
    """One column of a table, as tables of the pipeline are declared: its type, what it holds, its unit, its values.

    Values lie between `low` and `high`, or `among` the only ones allowed; they may be missing where the column is
    `nullable`, the column as a whole where it is `optional`. A ratio in `percent` is shown in per cent.
    """

    dtype: type
    description: str
    unit: str
    low: float | None
    high: float | None
    among: list[Any] | None
    nullable: bool
    optional: bool
    percent: bool


def column(
    dtype: type,
    description: str,
    unit: str = "1",
    low: float | None = None,
    high: float | None = None,
    *,
    among: Collection[Any] | None = None,
    nullable: bool = False,
    optional: bool = False,
) -> Column:
    """Return a column of int, float or str that is shown as it is kept."""
    return {
        "dtype": dtype,
        "description": description,
        "unit": unit,
        "low": low,
        "high": high,
        "among": None if among is None else list(among),
        "nullable": nullable,
        "optional": optional,
        "percent": False,
    }
