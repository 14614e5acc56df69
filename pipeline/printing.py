"""Frames and sentences on a terminal: a frame flows in, lines flow out."""

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd
import rich.table
from rich.console import Console
from rich.text import Text

from pipeline.command import split_command

ROWS_SHOWN_WHOLE = 60
LEAST_CHANCE = 1e-4
"""What a probability can be told to be below, or to be below 1 by: numerics and data tell no more."""
LEAST_TEXT = 14
"""Characters of a column of text up to which it is narrowed before others are left out."""
SHOWN = "shown in"
"""Of a column's metadata in a file: the unit in which it is to be read, where it is not the one in which it is kept."""


def print_frame(
    title: str, frame: pd.DataFrame, console: Console, limit: int = ROWS_SHOWN_WHOLE, option: str = ""
) -> None:
    """Print a frame as a terminal table, its first rows where it is long; `option` is what to type to see more."""
    console.print(title, style="bold", soft_wrap=True, highlight=False, markup=False)
    if frame.empty:
        console.print("  no rows\n", highlight=False)
        return
    if is_prose(frame):
        print_sentences(list(map(format_value, frame.iloc[:limit, 0])), console)
        return
    shown = rich.table.Table(header_style="bold", box=rich.box.SIMPLE_HEAD)
    cells = frame.head(limit).map(format_value)
    names = _choose_columns(cells, frame, console.width)
    for name in names:
        numeric = is_numeric(frame[name])
        shown.add_column(Text(str(name)), justify="right" if numeric else "left", overflow="fold", no_wrap=numeric)
    for row in cells[names].itertuples(index=False):
        shown.add_row(*map(Text, row))
    console.print(shown, markup=False)
    if len(names) < len(frame.columns):
        left = ", ".join(map(str, frame.columns[len(names) :]))
        console.print(f"  not shown in {console.width} columns: {left}", highlight=False, markup=False)
    if len(frame) > limit:
        more = f"; {option} {len(frame)} shows all" if option else ""
        console.print(f"  first {limit} of {len(frame)} rows{more}", highlight=False)


def _choose_columns(cells: pd.DataFrame, frame: pd.DataFrame, width: int) -> list[Any]:
    """Return the first columns of a frame that fit into a width with no number or heading broken, one at least."""
    names: list[Any] = []
    left = width - 2
    for name in frame.columns:
        longest = max([len(str(name)), *map(len, cells[name])])
        numeric = is_numeric(frame[name])
        left -= 3 + (longest if numeric else max(len(str(name)), min(longest, LEAST_TEXT)))
        if left < 0 and names:
            break
        names.append(name)
    return names


def print_sentences(sentences: Sequence[str], console: Console) -> None:
    """Print sentences, and a command that one ends with on a line of its own, not broken, so that it can be copied."""
    for each in sentences:
        told, command = split_command(each)
        lines = textwrap.wrap(told, console.width - 2, break_long_words=False, break_on_hyphens=False)
        console.print("\n".join(f"  {line}" for line in lines), highlight=False, markup=False, soft_wrap=True)
        if command:
            console.print(f"    {command}", highlight=False, markup=False, soft_wrap=True)
    console.print()


def is_prose(frame: pd.DataFrame) -> bool:
    """Return whether a table is a list of sentences: one column of text."""
    return len(frame.columns) == 1 and not pd.api.types.is_numeric_dtype(frame.iloc[:, 0])


def is_numeric(values: pd.Series) -> bool:
    """Return whether a column is of numbers, also where some are told as text, as by `format_chance`."""
    told = [isinstance(each, float) or str(each)[:2] in ("< ", "> ") for each in values]
    return pd.api.types.is_numeric_dtype(values) or (bool(told) and all(told))


def shorten(text: str, most: int) -> str:
    """Return a text that is not longer than so many characters, dots in place of its end."""
    return text if len(text) <= most else f"{text[: most - 3]}..."


def join_some(items: Sequence[str], most: int) -> str:
    """Return the first items in one phrase, with the number of those left out."""
    return ", ".join(items[:most]) + (f" and {len(items) - most} more" if len(items) > most else "")


def format_count(number: int, one: str, many: str = "") -> str:
    """Return a number with its noun, in the plural (`one` and an s unless it is given) but for 1."""
    return f"{number} {one if number == 1 else many or one + 's'}"


def format_counts(counts: Mapping[str, int]) -> str:
    """Return in one phrase how many there are of each word."""
    return ", ".join(f"{count} {word}" for word, count in counts.items())


def format_range(numbers: Any) -> str:
    """Return the least and the most of an array of whole numbers, or the one that they all are."""
    least, most = int(numbers.min()), int(numbers.max())
    return f"{least}" if least == most else f"{least} to {most}"


def format_value(value: Any) -> str:
    """Return a table cell's text: four significant digits for a float, a dash for a missing value."""
    if value is None or value is pd.NA or (isinstance(value, float) and value != value):
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def format_chance(value: float, is_probability: bool = False) -> float | str:
    """Return a number from 0 to 1, or in text that it is nearer to an end than can be told; a probability is no end."""
    low = value < LEAST_CHANCE and (is_probability or value != 0.0)
    high = value > 1.0 - LEAST_CHANCE and (is_probability or value != 1.0)
    return f"< {LEAST_CHANCE:.4f}" if low else f"> {1.0 - LEAST_CHANCE}" if high else value


def format_p(p: float) -> str:
    """Return in words what a p-value is, as far as it can be told."""
    return f"p < {LEAST_CHANCE:.4f}" if p < LEAST_CHANCE else f"p = {p:.2g}"


def show_percent(frame: pd.DataFrame, units: Mapping[str, str]) -> pd.DataFrame:
    """Return a frame as it is to be read: ratios whose unit is said to be % in per cent."""
    parts = [name for name, unit in units.items() if unit == "%" and name in frame.columns]
    return frame.assign(**{name: 100.0 * pd.to_numeric(frame[name], errors="coerce") for name in parts})


def show_metric(name: str, metric: Mapping[str, Any]) -> tuple[str, Any]:
    """Return the heading of a metric, as ledgers have it, with its unit, and its value in this unit."""
    parts = bool(metric.get("percent")) and isinstance(metric["value"], float)
    value = 100.0 * metric["value"] if parts else metric["value"]
    return add_unit(metric.get("title") or name, "%" if parts else str(metric["unit"])), value


def add_unit(name: str, unit: str) -> str:
    """Return a heading with its unit, where there is one that the name does not end in."""
    return name if unit in ("", "1") or name.lower().endswith(f"_{unit.lower()}") else f"{name} ({unit})"
