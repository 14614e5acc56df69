"""Text files of numbers as loggers write them: separators, decimal commas, preambles, units, rows that are no numbers.

A path flows in; the columns flow out, and a `Header` with what is out of the ordinary about them. A `ValueError` says
what to change. Lines count from 1, as in an editor.
"""

import bz2
import codecs
import csv
import gzip
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from stages.science.recording.units import KINDS, UNIT_KINDS, ZEROS, read_unit

SEPARATORS = ("\t", ";", ",", "|", "")
"""Between columns, the first of equals first; the empty one stands for blanks."""
SAID = {"\t": "tabs", ";": "semicolons", ",": "commas", "|": "bars", "": "blanks"}
COMMENT = re.compile(r"\s*(#|%|//|;|!|')+")
PACKED: Mapping[str, Callable[[bytes], bytes]] = {".gz": gzip.decompress, ".bz2": bz2.decompress}
NOTHING = frozenset(["", "nan", "na", "n/a", "#n/a", "#n/v", "null", "none", "nil", "-", "--", "---", "----", "*", "?"])
NOTHING |= {"#div/0!", "#value!", "#num!", "#ref!", "#nv", "#wert!", "#zahl!", "#bezug!", "#valeur!", "#nombre!"}
NOTHING |= {"1.#qnan", "-1.#ind", "1.#ind", "-nan", "-nan(ind)", "nan(ind)"}
"""Words for a missing value, in small letters."""
LOOKED = 400
"""Lines from which separators are told: so many from the middle, where hardly any head a table."""
CLEAR = 1.5
"""How many times as many values blanks must part as any other separator."""
WHOLE = 0.95
"""Share of fields that are values from which a separator parts all there is."""
LACKING = 0.1
"""Share of rows up to which those that lack their last values are left out."""
RAGGED, ENDS = 0.25, 3
"""Whole rows over shorter ones below which, if those are of more widths than so many, they are no table."""
LISTED, SHOWN = 5, 60
"""Lines that a remark lists, and characters that it shows of one."""
ODD = ("comments", "no row of numbers", "lacks its last values", "of another table", "below the table")
"""Why lines are no rows of a table."""
HEADS = 3
"""Rows above the values that may head the columns: names, units, and what was done to them."""
REMARKED = "comment"
"""Last name of a table whose rows end before it where there is nothing to remark; its head may end in a separator."""
APART = "'\u2019 \u00a0\u2009\u202f"
"""What sets thousands apart, beside the decimal sign of others."""
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
UNIT_LABEL = re.compile(r"\W*\w*unit", re.IGNORECASE)
"""How a line begins that tells the units of columns, away from their names."""
MOMENT = re.compile(r"\d{1,4}[-./]\d{1,2}[-./]\d{1,4}|\d{1,2}:\d{2}")
FACT = re.compile(rf"[^A-Za-z]*([A-Za-z][^:=\t;,]*?)\"?\s*[:=\t;,]+\s*\"?({NUMBER}|[-+]?\d+,\d+)\s*([^\d\s\";,]*)\W*")
"""A line that tells one number of a recording: its name, the number, its unit."""


@dataclass(frozen=True)
class Header:
    """What a file says of its columns: their names, units from a row of their own, and numbers that stand alone.

    Remarks tell how it is read, where that is out of the ordinary, and what cannot be read; `dropped` which rows of it
    are left out.
    """

    names: Sequence[str]
    units: Mapping[str, str]
    single: Mapping[str, float]
    remarks: Sequence[str]
    dropped: Sequence[str] = ()


@dataclass(frozen=True)
class _Column:
    """A column of fields: their numbers, which of them are numbers, moments and missing, and units of some by place.

    A column may have another decimal sign than the others.
    """

    decimal: str
    numbers: NDArray[np.generic]
    is_number: NDArray[np.bool_]
    is_moment: NDArray[np.bool_]
    missing: NDArray[np.bool_]
    units: Mapping[int, str]

    @property
    def told(self) -> bool:
        """Whether it is one of numbers or moments, as most of its fields are."""
        known = int((self.is_number | self.is_moment).sum())
        return known > 0 and known >= 0.5 * int((~self.missing).sum())

    def keep(self, kept: NDArray[np.int_]) -> tuple["_Column", str]:
        """Return the column's kept fields, and the unit that they hold: numbers in the commonest of one kind's."""
        at = {int(place): k for k, place in enumerate(kept)} if self.units else {}
        units = {at[place]: unit for place, unit in self.units.items() if place in at}
        numbers, is_number = self.numbers[kept], self.is_number[kept]
        counted = Counter(units.values()).most_common()
        if len(counted) > 1:
            kind, (usual, _) = KINDS[UNIT_KINDS[counted[0][0]]], counted[0]
            if {*ZEROS} & {*units.values()} or not {*units.values()} <= {*kind} or len(units) < is_number.sum():
                told = " and ".join(unit for unit, _ in counted)
                raise ValueError(
                    f"expected values of one unit in a column, got {told}, or some without; write it in one"
                )
            for place, unit in units.items():
                numbers[place] *= kind[unit] / kind[usual]
        moments, missing = self.is_moment[kept], self.missing[kept]
        return _Column(self.decimal, numbers, is_number, moments, missing, units), counted[0][0] if counted else ""


def read_delimited(path: Path) -> tuple[pd.DataFrame, Header]:
    """Return the table of a text file: the rows of numbers of one width, and what heads their columns."""
    text, encoding = _decode(path)
    lines = text.splitlines()
    separator, decimal, width = _choose(lines)
    places, fields = _split_all(lines, separator, width)
    columns = [_read_column(fields[name], decimal) for name in fields]
    if not any(each.told for each in columns):
        raise ValueError(
            f"expected rows of numbers, got {next(filter(str.strip, lines), '').strip()[:SHOWN]!r} and the like"
        )
    kept = _find_rows(columns)
    if _counts_columns(fields.iloc[kept[: LOOKED + 1]]):
        kept = kept[1:]
    rows, first, last = places[kept], int(places[kept][0]), int(places[kept][-1])
    if len(rows) < 2:
        raise ValueError("expected two rows of numbers or more, got one")
    ended = bool(columns[-1].missing[kept].all())
    names, units, above = _find_heads(lines[:first], separator, decimal, width, ended)
    dropped = _describe_odd(lines, {*map(int, rows)}, (first, last), (separator, decimal, width), (names, units))
    told = _name(names, columns, kept)
    settled = {name: columns[k].keep(kept) for k, name in told.items()}
    frame = pd.DataFrame({name: _settle(settled[name][0], fields[k].iloc[kept]) for k, name in told.items()})
    own = {name: settled[name][1] or (units[k] if units else "") for k, name in told.items()}
    others = [name for name, (column, _) in settled.items() if column.decimal != decimal]
    remarks = {
        f"columns separated by {SAID[separator]}": separator != "," and width > 1,
        "decimal commas": decimal == "," and any(each.told for each in columns),
        f"{'points, not commas,' if decimal == ',' else 'commas, not points,'} before decimals, and the other before "
        f"thousands, in {', '.join(others)}": bool(others),
        f"a row of units: {', '.join(filter(None, units))}": any(units),
        "no names of columns, which are counted: column_1, column_2, ...": not names,
        "characters of Windows (cp1252); if names look wrong, save the file as UTF-8": encoding == "cp1252",
        f"{_count(above, 'line')} above the table left alone": above > 0,
    }
    said = tuple(each for each, holds in remarks.items() if holds)
    single = _list_facts(lines[: first - (len(names) > 0)])
    return frame, Header(list(told.values()), {name: unit for name, unit in own.items() if unit}, single, said, dropped)


def _decode(path: Path) -> tuple[str, str]:
    """Return a file as text, and its encoding."""
    raw = PACKED.get(path.suffix.lower(), bytes)(path.read_bytes())
    if not raw.rstrip(b"\0").strip():
        raise ValueError("it is empty")
    wide = raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    for encoding in ["utf-16"] if wide else ["utf-8-sig", "cp1252"]:
        try:
            text = raw.decode(encoding)
            break
        except UnicodeDecodeError:
            if encoding != "utf-8-sig":
                raise ValueError("it is no text in UTF-8, UTF-16 or Windows' cp1252; save it as UTF-8") from None
    if "\0" in text.rstrip("\0"):
        raise ValueError("it holds no text, or text in UTF-16 or UTF-32 without its mark; save it as UTF-8")
    return re.sub("[\u2212\u2013](?=[\\d.,])", "-", text.rstrip("\0")), encoding


def _split(line: str, separator: str) -> list[str]:
    if not separator:
        return line.split()
    if '"' not in line:
        return [each.strip() for each in line.split(separator)]
    return [each.strip() for each in next(csv.reader([line.strip("\r\n ")], delimiter=separator), [])]


def _to_number(field: str, decimal: str, thousands: bool = False) -> float | None:
    """Return the number that a field spells, maybe with a D before its exponent, or with thousands set apart."""
    told = field.lstrip("+").replace("D", "e").replace("d", "e") if field[:1] in "+-.0123456789" else field
    apart = ("," if decimal == "." else ".") + APART
    if any(each in told for each in apart):
        if not thousands or not re.fullmatch(rf"-?[1-9]\d{{0,2}}([{apart}])\d{{3}}(\1\d{{3}})*(\{decimal}\d+)?", told):
            return None
        told = re.sub(f"[{apart}]", "", told)
    told = told.replace(decimal, ".")
    return float(told) if re.fullmatch(rf"{NUMBER}|[-+]?inf(inity)?", told, re.IGNORECASE) else None


def _choose(lines: Sequence[str]) -> tuple[str, str, int]:
    """Return separator, decimal sign and number of columns under which most fields of the middle lines are values."""
    told = [line for line in lines if line.strip() and not COMMENT.match(line)]
    if not told:
        raise ValueError("No columns to parse from file")
    middle = max((len(told) - LOOKED) // 2, 0)
    looked = told[middle : middle + LOOKED]
    found: dict[tuple[str, str], tuple[float, int]] = {}
    whole: set[tuple[str, str]] = set()
    for separator in SEPARATORS:
        rows = [_split(line, separator) for line in looked]
        for decimal in (".", ","):
            good = [sum(_is_value(each, decimal) for each in row) for row in rows]
            parted: Counter[int] = Counter()
            for row, count in zip(rows, good, strict=True):
                parted[len(row)] += count
            width = max(parted, key=lambda each: (parted[each], each))
            alike = [row for row in rows if len(row) == width]
            filled = sum(each.lower() not in NOTHING for row in alike for each in row)
            found[separator, decimal] = parted[width] ** 2 / max(filled, 1) * len(alike) / len(rows), width
            if width > 1 and parted[width] >= WHOLE * filled and len(alike) >= WHOLE * len(rows):
                whole.add((separator, decimal))
    by_blanks = max((("", decimal) for decimal in (".", ",")), key=lambda each: found[each][0])
    others = [each for each in found if each[0]]
    best = max(others, key=lambda each: found[each][0])
    if best in whole:  # blanks set thousands apart
        return *best, found[best][1]
    if found[by_blanks][0] > CLEAR * found[best][0] or (found[best][1] == 1 and found[by_blanks][1] > 1):
        best = by_blanks
    elif found[best][1] == 1:
        best = ",", best[1]
    return *best, found[best][1]


def _is_value(field: str, decimal: str) -> bool:
    if _to_number(field, decimal) is not None or MOMENT.match(field) or _split_unit(field, decimal) is not None:
        return True
    return decimal in field and _to_number(field, decimal, thousands=True) is not None


def _split_unit(field: str, decimal: str) -> tuple[float, str] | None:
    """Return the number and the unit of a field such as ``3.2 bar``."""
    found = re.fullmatch(r"([-+]?[\d.,]+(?:[eE][-+]?\d+)?)\s*((?:1/)?[^\d\s.,+-]\S*)", field)
    if not found or (unit := read_unit(found.group(2))) is None:
        return None
    number = _to_number(found.group(1), decimal)
    return None if number is None else (number, unit)


def _split_all(lines: Sequence[str], separator: str, width: int) -> tuple[NDArray[np.int_], pd.DataFrame]:
    """Return the lines that part into so many fields, counted from 0, and their fields as text.

    Where many have fewer, their writer omits empty ones at the end, which are added.
    """
    if separator and not any('"' in line for line in lines):
        counts = np.array([line.count(separator) + 1 for line in lines])
        rows = [line.split(separator) if count <= width else [] for line, count in zip(lines, counts, strict=True)]
    else:
        rows = [_split(line, separator) for line in lines]
        counts = np.array([len(row) for row in rows])
    fits = counts == width
    short = (counts < width) & (counts > 1)
    if fits.sum() < RAGGED * short.sum() and len(set(counts[short])) > ENDS:
        raise ValueError(f"expected rows of one width, got rows of {counts[short].min()} to {width} fields")
    if LACKING * fits.sum() < short.sum() and separator:
        fits |= short
    places = np.flatnonzero(fits)
    filled = [rows[k] if len(rows[k]) == width else [*rows[k], *[""] * (width - len(rows[k]))] for k in places]
    return places, pd.DataFrame(filled, columns=range(width), dtype=object).apply(lambda column: column.str.strip())


def _read_column(fields: pd.Series, decimal: str) -> _Column:
    """Return what the fields of a column are."""
    if _has_other_sign(fields, decimal):
        decimal = "." if decimal == "," else ","
    missing = fields.str.lower().isin(NOTHING).to_numpy()
    plain = fields
    if decimal == ",":
        plain = fields.str.replace(",", ".", regex=False).where(~fields.str.contains(".", regex=False), "?")
    values = pd.to_numeric(plain.where(~missing, None), errors="coerce")
    is_number = (values.notna() & ~fields.str.contains("_", regex=False)).to_numpy(copy=True)
    is_moment = (~pd.Series(missing | is_number) & fields.str.match(MOMENT)).to_numpy()
    numbers = values.to_numpy(copy=True)
    units: dict[int, str] = {}
    left = np.flatnonzero(~(is_number | is_moment | missing))
    if len(left):
        numbers = numbers.astype(float)
    for place in left:
        field = str(fields.iloc[place])
        number = _to_number(field, decimal, thousands=True)
        if number is None and (told := _split_unit(field, decimal)) is not None:
            number, units[int(place)] = told
        if number is not None:
            numbers[place], is_number[place] = number, True
    return _Column(decimal, numbers, is_number, is_moment, missing, units)


def _has_other_sign(fields: pd.Series, decimal: str) -> bool:
    """Return whether what would be a column's decimal sign sets thousands apart, or what would set them is that sign.

    The former sets apart three digits each time, twice in a number, or in all from a thousand on and in none below,
    some of a hundred and more. No thousands begin with a zero, or are more digits than three, or less.
    """
    other = "." if decimal == "," else ","
    apart = fields[fields.str.fullmatch(r"[-+]?\d[\d.,]*")]
    signed = apart[apart.str.contains(decimal, regex=False)]
    if signed.empty:
        wrong = apart.str.fullmatch(rf"[-+]?(0\{other}\d+|\d+\{other}(\d{{1,2}}|\d{{4,}}))")
        return bool(wrong.any() and apart.str.fullmatch(rf"[-+]?\d+(\{other}\d+)?").all())
    if not signed.str.fullmatch(rf"[-+]?[1-9]\d{{0,2}}(\{decimal}\d{{3}})+(\{other}\d+)?").all():
        return False
    plain = apart[~apart.str.contains(r"[.,]", regex=True)].str.lstrip("+-").str.len()
    return bool((signed.str.count(re.escape(decimal)) > 1).any() or plain.max() == 3)


def _find_rows(columns: Sequence[_Column]) -> NDArray[np.int_]:
    """Return the rows of values: at least half of what should be one is, above all in the first such column."""
    told = [each for each in columns if each.told]
    values = np.stack([each.is_number | each.is_moment for each in told])
    good = values | np.stack([each.missing for each in told])
    rows = np.flatnonzero(good[0] & values.any(axis=0) & (good.mean(axis=0) >= 0.5))
    first = columns[0].missing[rows]
    return rows[first] if not columns[0].told and first.mean() > 0.5 else rows  # what it holds heads a row


def _counts_columns(rows: pd.DataFrame) -> bool:
    """Return whether the first row numbers the columns, from 0 or 1 on: the only one of whole numbers alone.

    Of two columns, it may be where a cosine begins.
    """
    whole = rows.apply(lambda column: column.str.fullmatch(r"\d+")).all(axis=1).to_numpy()
    told = [list(map(str, range(first, first + rows.shape[1]))) for first in (0, 1)]
    return rows.shape[1] > 2 and len(rows) > 1 and not whole[1:].any() and rows.iloc[0].tolist() in told


def _settle(column: _Column, fields: pd.Series) -> pd.Series:
    """Return a column's values: numbers if all of them are, else text with decimal points; with what is missing."""
    own, missing = fields.reset_index(drop=True), column.missing
    if column.is_number.any() and (column.is_number | missing).all():
        numbers = pd.Series(column.numbers)
        whole = not missing.any() and not own.str.contains(r"[.,eE]", regex=True).any()
        return numbers.astype(np.int64) if whole and (np.abs(numbers) < 2**62).all() else numbers.astype(float)
    if column.decimal == ",":
        plain = own.str.replace(".", "", regex=False).str.replace(",", ".", regex=False)
        own = own.where(~column.is_number, plain)
    return own.where(~missing, None).astype(object) if not missing.all() else pd.Series(np.full(len(own), np.nan))


def _find_heads(
    lines: Sequence[str], separator: str, decimal: str, width: int, ended: bool
) -> tuple[list[str], list[str], int]:
    """Return the columns' names and units, as far as the lines above the values tell them, and how many lines are left.

    If lines of values are `ended` by a separator, names need not be.
    """
    heads: list[list[str]] = []
    for line in reversed(lines):
        found = None if separator and line.startswith(separator) else COMMENT.match(line)
        bare = line[found.end() :] if found else line
        row = _split_head(bare, separator, width, ended)
        above_units = len(heads) == 1 and _count_units(heads[0]) == 1.0  # where channels may be but numbered
        names = row[:1] if row and above_units else row
        if row and names and any(row) and not any(_to_number(each, decimal) is not None for each in names):
            heads.append(row)
        elif bare.strip() and not found:
            if not heads:
                _refuse_other_width(_split(bare, separator), separator, decimal, width)
            break
        if len(heads) == HEADS:
            break
    known = {k: share for k, row in enumerate(heads[:-1]) if (share := _count_units(row)) >= 0.5}
    units = max(known, key=known.__getitem__, default=None)
    used = heads[:1] if units is None else heads[units : units + 2]
    left = sum(bool(line.strip()) for line in lines) - len(used)
    if units is None:
        apart = (_split_head(line, separator, width, ended) for line in lines if UNIT_LABEL.match(line))
        labelled = next((["", *row[1:]] for row in apart if row and _count_units(row[1:]) >= 0.5), [])
        return (heads[0] if heads else []), labelled if heads else [], left
    return heads[units + 1], [each.strip("[]()") for each in heads[units]], left


def _split_head(line: str, separator: str, width: int, ended: bool) -> list[str] | None:
    """Return the fields of a line above the values if they are as many as columns; names may have blanks in them."""
    row = _split(line.strip(" \r\n"), separator)
    if not separator and len(row) != width:
        row = re.split(r"\s{2,}|\t", line.strip())
    if ended and len(row) == width - 1:
        row = [*row, ""]
    if len(row) == width + 1 and row[-1].lower() in ("", REMARKED):
        del row[-1]
    return row if len(row) == width else None


def _count_units(row: Sequence[str]) -> float:
    """Return the share of a row's fields that are units, or stand in brackets as these do."""
    filled = [each for each in row if each]
    known = [re.fullmatch(r"\[.*\]|\(.*\)", each) or read_unit(each) is not None for each in filled]
    return sum(map(bool, known)) / max(len(filled), 1)


def _refuse_other_width(row: Sequence[str], separator: str, decimal: str, width: int) -> None:
    """Refuse names that are fewer or more than the columns below them."""
    if len(row) < 2 or any(_is_value(each, decimal) for each in row) or not all(row):
        return
    remedy = "put # before the lines above the names of the columns"
    if separator == "," and width > len(row):
        remedy = f"if its numbers have decimal commas, write it with semicolons between the columns; else {remedy}"
    raise ValueError(f"the line above its values has {len(row)} fields and these have {width}; {remedy}")


def _name(names: Sequence[str], columns: Sequence[_Column], kept: NDArray[np.int_]) -> dict[int, str]:
    """Return the name of each column: numbered where it comes again or is not told; an empty one needs none."""
    seen: Counter[str] = Counter()
    found = {}
    for k, column in enumerate(columns):
        name = names[k] if names else ""
        if not name and names and column.missing[kept].all():
            continue
        name = name or f"column_{k + 1}"
        found[k] = f"{name}.{seen[name]}" if seen[name] else name
        seen[name] += 1
    return found


def _list_facts(lines: Iterable[str]) -> dict[str, float]:
    """Return the numbers that lines above a table tell of it, by their names; times in s, frequencies in Hz."""
    found = {}
    for line in lines:
        name, *values = line.strip().split("\t")
        each_alike = len(values) > 1 and len({*values}) == 1  # a table may tell a number for each of its columns
        if told := FACT.fullmatch("\t".join([name, values[0]]) if each_alike else line.strip()):
            name, number, unit = told.groups()
            known = read_unit(unit)
            scale = next((KINDS[kind][known] for kind in ("time", "frequency") if known in KINDS[kind]), 1.0)
            found[name.strip()] = scale * float(number.replace(",", "."))
    return found


def _describe_odd(
    lines: Sequence[str],
    rows: set[int],
    ends: tuple[int, int],
    layout: tuple[str, str, int],
    heads: tuple[Sequence[str], Sequence[str]],
) -> tuple[str, ...]:
    """Return a remark for each reason why lines from the first row on are no rows of the table.

    A table in which a few rows have more values than the others is refused; many are another table. So is one that is
    headed anew by other names or units than its `heads`.
    """
    separator, decimal, width = layout
    known = {each.casefold() for each in heads[0] if each}
    comments, text, short, long, after = found = [list[int]() for _ in ODD]
    for place in range(ends[0], len(lines)):
        if place in rows or not lines[place].strip(f" \r\n{separator}"):
            continue
        parts = _split(lines[place], separator)
        values = sum(_is_value(each, decimal) for each in parts)
        if COMMENT.match(lines[place]):
            comments.append(place + 1)
        elif (len(parts) < width and values == len(parts)) or (values and _is_value(parts[0], decimal)):
            (long if len(parts) > width else short).append(place + 1)
        else:
            if len(parts) == width and (_count_units(parts) >= 0.5 or known & {each.casefold() for each in parts}):
                _refuse_other_heads(parts, heads, place + 1)
            (after if place > ends[1] else text).append(place + 1)
    if long and len(long) < max(LACKING * len(rows), 4):
        saw = len(_split(lines[long[0] - 1], separator))
        raise ValueError(f"Expected {width} fields in line {long[0]}, saw {saw}")
    return tuple(
        f"{_count(len(places), 'line')} left out, {why}: {', '.join(map(str, places[:LISTED]))}"
        f"{', ...' if len(places) > LISTED else ''}"
        for why, places in zip(ODD, found, strict=True)
        if places
    )


def _refuse_other_heads(row: Sequence[str], heads: tuple[Sequence[str], Sequence[str]], line: int) -> None:
    """Refuse names or units within a table that are not those above it."""
    names, units = heads
    if list(row) != list(names) and [each.strip("[]()") for each in row] != list(units):
        above = ", ".join(units if _count_units(row) >= 0.5 and units else names)
        raise ValueError(
            f"line {line} heads the columns anew, by {', '.join(row)}, and the lines above the values by {above}; save "
            "what follows it as a file of its own"
        )


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
