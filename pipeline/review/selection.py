"""Which rows of a frame to see, in which order: ``KEY=VALUE`` and a column flow in, a frame flows out."""

import math
import operator
import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import pandas as pd

from pipeline.errors import ConfigError, suggest

SIGNS = re.compile(r"!=|<=|>=|==?|~|<|>")
COMPARISONS = {"<": operator.lt, ">": operator.gt, "<=": operator.le, ">=": operator.ge}


class Condition(NamedTuple):
    """What a row must fulfil: a key, ``=``, ``!=``, ``~``, ``<``, ``>``, ``<=`` or ``>=``, and a value as typed."""

    key: str
    sign: str
    value: str

    def holds(self, value: object) -> bool:
        """Return whether a value fulfils the condition; a missing one equals nothing but ``-``."""
        text = "-" if _is_missing(value) else str(value)
        if self.sign == "~":
            return self.value.lower() in text.lower()
        number, wanted = read_number(text), read_number(self.value)
        if self.sign in ("=", "!="):
            same = text == self.value or (number is not None and number == wanted)
            return same == (self.sign == "=")
        return number is not None and wanted is not None and bool(COMPARISONS[self.sign](number, wanted))


def read_condition(text: str) -> Condition:
    """Return what ``KEY=VALUE`` and the like ask for, or raise `ConfigError` where it is no condition."""
    found = SIGNS.search(text)
    if found is None or found.start() == 0:
        raise ConfigError(f"--where {text}: expected KEY=VALUE, KEY!=VALUE, KEY~TEXT, or 'KEY<NUMBER' and the like")
    sign, value = found.group().replace("==", "="), text[found.end() :].strip()
    if sign[0] in "<>" and read_number(value) is None:
        raise ConfigError(f"--where {text}: expected a number after {sign}, got '{value}'")
    return Condition(text[: found.start()].strip(), sign, value)


def keep_rows(frame: pd.DataFrame, conditions: Iterable[Condition]) -> pd.DataFrame:
    """Return the rows that fulfil all conditions, or raise `ConfigError` where one is about no column."""
    for each in conditions:
        _check_key("--where", each.key, frame)
        frame = frame[[each.holds(value) for value in frame[each.key]]]
    return frame


def sort_rows(frame: pd.DataFrame, by: str | None) -> pd.DataFrame:
    """Return the rows in the order of a column, largest first where ``-`` stands before it, missing values last.

    It raises `ConfigError` where there is no such column.
    """
    if by is None:
        return frame
    key = by if by in frame.columns else by.removeprefix("-")
    _check_key("--sort", key, frame)
    orders = pd.Series([None if _is_missing(value) else order_of(str(value)) for value in frame[key]], dtype=object)
    return frame.iloc[orders.sort_values(ascending=key == by, kind="stable").index]


def _check_key(option: str, key: str, frame: pd.DataFrame) -> None:
    names = [str(each) for each in frame.columns]
    if key not in names:
        raise ConfigError(f"{option} {key}: no such column; {suggest(key, names)}")


def order_of(text: str) -> tuple[bool, float, str]:
    """Return a sort key by which numbers come first, as numbers."""
    number = read_number(text)
    return number is None, 0.0 if number is None else number, text


def read_number(text: str) -> float | None:
    """Return the number that a text is, also in per cent, or None."""
    try:
        number = float(text[:-1]) / 100.0 if text.endswith("%") else float(text)
    except ValueError:
        return None
    return None if math.isnan(number) else number


def put_sort_together(arguments: Sequence[str]) -> list[str]:
    """Return a command line in which ``--sort -COLUMN`` is one word, as argparse takes the second for an option."""
    joined: list[str] = []
    for each in arguments:
        if joined and joined[-1] == "--sort":
            joined[-1] = f"--sort={each}"
        else:
            joined.append(each)
    return joined


def _is_missing(value: object) -> bool:
    return value is None or value is pd.NA or value is pd.NaT or (isinstance(value, float) and math.isnan(value))
