"""Text files of numbers as other programs write them: separators, decimal commas, comments, a row of units.

The first lines of a file flow in; what is needed to read it flows out, or a `ValueError` that says what to change.
"""

import codecs
import csv
import re
import warnings
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

SEPARATORS = ("\t", ";", ",", "")
"""Between columns, the first of equals first; the empty one stands for blanks."""
SAID = {"\t": "tabs", ";": "semicolons", ",": "commas", "": "blanks"}
COMMENTS = ("#", "%", "//")
SAMPLE_BYTES, SAMPLE_LINES = 1 << 16, 60
NOTHING = ("", "nan", "na", "n/a", "null", "none")


@dataclass(frozen=True)
class Dialect:
    """How a text file is to be read: its characters, what separates columns and decimals, and what heads the columns.

    `first_line` counts the lines before the first row of values; units are those of a row of their own, if there is
    one; remarks tell what is out of the ordinary.
    """

    encoding: str
    separator: str
    decimal: str
    first_line: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    remarks: tuple[str, ...]


def find_dialect(path: Path) -> Dialect:
    """Return how a text file is to be read, from its first lines; a `ValueError` tells that it holds no table."""
    text, encoding, whole = _read_sample(path)
    lines = text.splitlines()[: None if whole else -1][:SAMPLE_LINES]
    kept = [k for k, line in enumerate(lines) if line.strip() and not line.lstrip().startswith(COMMENTS)]
    if not kept:
        raise ValueError("No columns to parse from file")
    separator, decimal = _choose([lines[k] for k in kept])
    rows = {k: _split(lines[k], separator) for k in kept}
    width = len(rows[kept[0]])
    comments = {k: _split(lines[k].lstrip().lstrip("#%/"), separator) for k in range(len(lines)) if k not in kept}
    told, units, after = _name_columns(kept, rows, [comments[k] for k in comments if k < kept[0]], decimal)
    first_line = kept[after] if after < len(kept) else len(lines)
    beside = (each for k, each in comments.items() if kept[0] < k < first_line and len(each) == width and any(each))
    units = units or next(beside, [])
    remarks = {
        f"columns separated by {SAID[separator]}": separator != ",",
        "decimal commas": decimal == ",",
        f"a row of units: {', '.join(units)}": any(units),
        "no names of columns, which are counted: column_1, column_2, ...": not told,
        "characters of Windows (cp1252)": encoding == "cp1252",
    }
    said = tuple(each for each, holds in remarks.items() if holds)
    names = _each_once(told or [f"column_{k + 1}" for k in range(width)])
    bare = tuple(each.strip("[]()") for each in units) if any(units) else ()
    return Dialect(encoding, separator, decimal, first_line, tuple(names), bare, said)


def read_delimited(path: Path, dialect: Dialect, names: Collection[str] | None) -> pd.DataFrame:
    """Return the rows of a text file, of all columns or of those of these names; a `ValueError` tells a longer row."""
    try:
        frame = _read(path, dialect, dialect.encoding)
    except UnicodeDecodeError:
        if dialect.encoding != "utf-8-sig":
            raise
        frame = _read(path, dialect, "cp1252")
    return frame[[each for each in dialect.names if each and (names is None or each in names)]]


def _read(path: Path, dialect: Dialect, encoding: str) -> pd.DataFrame:
    with warnings.catch_warnings():
        warnings.simplefilter("error", pd.errors.ParserWarning)  # pandas would drop what stands beyond the last name
        try:
            return pd.read_csv(
                path,
                sep=dialect.separator or r"\s+",
                decimal=dialect.decimal,
                encoding=encoding,
                header=None,
                names=[each or " " * (k + 1) for k, each in enumerate(dialect.names)],
                skiprows=dialect.first_line,
                index_col=False,
                skipinitialspace=True,
                low_memory=False,
            )
        except pd.errors.ParserWarning:
            raise ValueError(f"expected {len(dialect.names)} values in each row, as many as names, got more") from None


def _read_sample(path: Path) -> tuple[str, str, bool]:
    """Return the beginning of a file as text, its encoding, and whether that is all of it."""
    with path.open("rb") as handle:
        raw = handle.read(SAMPLE_BYTES)
        whole = not handle.read(1)
    encodings = ["utf-16"] if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else ["utf-8-sig", "cp1252"]
    for encoding in encodings:
        try:
            text = codecs.getincrementaldecoder(encoding)().decode(raw, final=whole)
            break
        except UnicodeDecodeError:
            if encoding == encodings[-1]:
                raise
    if "\0" in text:
        raise ValueError("it holds no text")
    return text, encoding, whole


def _split(line: str, separator: str) -> list[str]:
    if not separator:
        return line.split()
    return [each.strip() for each in next(csv.reader([line.strip("\r\n ")], delimiter=separator), [])]


def _is_number(field: str, decimal: str) -> bool:
    if decimal == ",":
        if "." in field:
            return False
        field = field.replace(",", ".")
    try:
        float(field)
    except ValueError:
        return False
    return "_" not in field


def _choose(lines: Sequence[str]) -> tuple[str, str]:
    """Return separator and decimal sign under which the rows agree best with the first one and are numbers."""
    found = {}
    for separator in SEPARATORS:
        rows = [_split(line, separator) for line in lines]
        width, values = len(rows[0]), rows[1:] or rows
        fitting = sum(len(row) == width or (len(row) == width + 1 and not row[-1]) for row in values) / len(values)
        for decimal in (".", ",")[: min(width, 2)]:
            fields = [field for row in values for field in row if field.lower() not in NOTHING]
            numbers = sum(_is_number(field, decimal) for field in fields) / max(len(fields), 1)
            found[separator, decimal] = (fitting * numbers, width, fitting)
    best = max(found, key=lambda each: found[each])
    if found[best][0] == 0.0:
        best = max(SEPARATORS[:3], key=lambda each: len(_split(lines[-1], each))), "."
    if found[best][2] < 0.5:
        width, *others = (len(_split(line, best[0])) for line in lines)
        other = next(each for each in others if each != width)
        remedy = "put # before the lines above the names of the columns"
        if best[0] == "," and other > width:
            remedy = f"if its numbers have decimal commas, write it with semicolons between the columns; else {remedy}"
        raise ValueError(f"its first line has {width} fields and those below have {other}; {remedy}")
    return best


def _name_columns(
    kept: Sequence[int], rows: dict[int, list[str]], comments: Sequence[Sequence[str]], decimal: str
) -> tuple[list[str], list[str], int]:
    """Return the columns' names and units, as far as they are told, and how many rows do that."""
    header = rows[kept[0]]
    if _count_numbers(header, decimal) == sum(each.lower() not in NOTHING for each in header) > 0:
        matching = [list(each) for each in comments if len(each) == len(header)]
        units = matching.pop() if len(matching) > 1 and _are_bracketed(matching[-1]) else []
        return (matching[-1] if matching else []), units, 0
    second = rows[kept[1]] if len(kept) > 2 else []
    if any(second) and not _count_numbers(second, decimal) and _count_numbers(rows[kept[2]], decimal):
        return header, second, 2
    return header, [], 1


def _count_numbers(fields: Sequence[str], decimal: str) -> int:
    return sum(_is_number(each, decimal) for each in fields if each.lower() not in NOTHING)


def _are_bracketed(fields: Sequence[str]) -> bool:
    return all(re.fullmatch(r"\[.*\]|\(.*\)|", each) for each in fields) and any(fields)


def _each_once(names: Sequence[str]) -> list[str]:
    """Return names with a number behind what comes again; those of columns without a name stay empty."""
    seen: Counter[str] = Counter()
    found = []
    for name in names:
        found.append(f"{name}.{seen[name]}" if seen[name] and name else name)
        seen[name] += 1
    return found
