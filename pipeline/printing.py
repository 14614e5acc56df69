"""Frames as tables of a terminal: a frame flows in, lines flow out."""

from collections.abc import Sequence
from typing import Any

import pandas as pd
import rich.table
from rich.console import Console
from rich.text import Text

ROWS_SHOWN_WHOLE = 60


def print_frame(
    title: str, frame: pd.DataFrame, console: Console, limit: int = ROWS_SHOWN_WHOLE, option: str = ""
) -> None:
    """Print a frame as a terminal table, its first rows where it is long; `option` is what to type to see more."""
    console.print(title, style="bold", soft_wrap=True, highlight=False, markup=False)
    if frame.empty:
        console.print("  no rows\n", highlight=False)
        return
    if is_prose(frame):
        for sentence in frame.iloc[:limit, 0]:
            console.print(f"  {sentence}", highlight=False, markup=False)
        console.print()
        return
    shown = rich.table.Table(header_style="bold", box=rich.box.SIMPLE_HEAD)
    for name in frame.columns:
        numeric = pd.api.types.is_numeric_dtype(frame[name])
        shown.add_column(Text(str(name)), justify="right" if numeric else "left", overflow="fold")
    for row in frame.head(limit).itertuples(index=False):
        shown.add_row(*(Text(format_value(value)) for value in row))
    console.print(shown, markup=False)
    if len(frame) > limit:
        more = f"; {option} {len(frame)} shows all" if option else ""
        console.print(f"  first {limit} of {len(frame)} rows{more}", highlight=False)


def is_prose(frame: pd.DataFrame) -> bool:
    """Return whether a table is a list of sentences: one column of text."""
    return len(frame.columns) == 1 and not pd.api.types.is_numeric_dtype(frame.iloc[:, 0])


def shorten(text: str, most: int) -> str:
    """Return a text that is not longer than so many characters, dots in place of its end."""
    return text if len(text) <= most else f"{text[: most - 3]}..."


def join_some(items: Sequence[str], most: int) -> str:
    """Return the first items in one phrase, with the number of those left out."""
    return ", ".join(items[:most]) + (f" and {len(items) - most} more" if len(items) > most else "")


def format_count(number: int, one: str, many: str = "") -> str:
    """Return a number with its noun, in the plural (`one` and an s unless it is given) but for 1."""
    return f"{number} {one if number == 1 else many or one + 's'}"


def format_range(numbers: Any) -> str:
    """Return the least and the most of an array of whole numbers, or the one that they all are."""
    least, most = int(numbers.min()), int(numbers.max())
    return f"{least}" if least == most else f"{least} to {most}"


def format_value(value: Any) -> str:
    """Return a table cell's text: four significant digits for a float, a dash for a missing value."""
    if value is None or value is pd.NA or (isinstance(value, float) and value != value):
        return "-"
    if isinstance(value, float):
        return f"{value:.4g}"
    return str(value)


def add_unit(name: str, unit: str) -> str:
    """Return a heading with its unit, where there is one."""
    return name if unit in ("", "1") else f"{name} ({unit})"
