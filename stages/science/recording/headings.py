"""What the heading of a recorded column says: the quantity's name, its unit, and whether that fits the column's use.

Headings flow in, with units from a row of their own; names and units flow out, or a `RecordingError`.
"""

import re
from collections.abc import Mapping
from typing import NamedTuple

from stages.science.recording.columns import RecordingError, assign
from stages.science.recording.units import (
    ENDS,
    OTHER_SPELLINGS,
    UNIT_KINDS,
    ZEROS,
    choose_unit,
    end_of,
    known_units,
    own_unit,
    read_unit,
)

BRACKETED = re.compile(r"^(.*?)\s*[\[({]\s*([^\[({\])}]+?)\s*[\])}]\s*$")
BETWEEN = re.compile(r"\s+in\s+|\s*[/,;]\s*|[\s_.]+|(?<=\w)(?=[%°])")
"""Separators between a quantity and its unit."""
LABELS = ("record", "part", "trial", "muscle")
"""Columns that label rows, whatever unit their headings state."""
SYMBOLS = ("n", "v", "a", "w")
"""Letters after a blank that are symbols of a quantity, as in ``Drehzahl n``; the units are capitals."""
SIGNS = ("in", "/", ",", ";")
"""Separators after which a unit is unmistakable."""
NAMES_BESIDES = ("k", "g", "w", "a", "in", "-")
"""Endings that are more often part of a name than a unit."""
ONLY_IN_COMPOUNDS = re.compile("l|ml|h|J|kJ|mol|lb|ft|oz|ohm|rev|inc|counts|dB|m2|m3")
"""Pieces of compound units that cannot be converted."""
CLOCK = re.compile(
    r"(.*[\W_])?(t|dt|tau|\w*time\w*|\w*zeit\w*|temps|elapsed|\w*duration|dauer|\w*delay|lag|period|\w*stamp|clock)",
    re.IGNORECASE,
)
"""Names of quantities in units of time; after other names, a unit of time is part of a compound unit."""


class Heading(NamedTuple):
    """Quantity and unit, which is `plain` where it was set apart or is more than one letter."""

    name: str
    unit: str | None
    plain: bool


def read_heading(text: str, told: str = "") -> Heading:
    """Return what a heading such as ``Force (kN)``, ``p1_kPa`` or ``v_m_s`` says, with any unit from a row of units."""
    if told and (unit := read_unit(told)) is not None:
        return Heading(read_heading(text).name, unit, True)
    found = BRACKETED.match(text)
    if found and (unit := read_unit(found.group(2))) is not None:
        return Heading(found.group(1), unit, True)
    for gap in BETWEEN.finditer(text):
        name, end, sign = text[: gap.start()], text[gap.end() :].strip(), gap.group().strip()
        symbol = gap.group().isspace() and end in SYMBOLS
        unit = _read_end(end, sign in SIGNS) if name and not symbol else None
        if unit is not None:
            known = not _is_compound(name, unit, gap.group())
            return Heading(name, unit, sign in SIGNS or len(end) > 1) if known else Heading(text, None, False)
    return Heading(text, None, False)


def _read_end(end: str, apart: bool) -> str | None:
    """Return the unit that the end of a heading states, with underscores or as it is written."""
    if not apart and end.lower() in NAMES_BESIDES:
        return None
    spelled = re.sub(r"[\s_.]+", "_", end).lower()
    spelled = re.sub(r"_(s2?|min|h)$", r"_per_\1", spelled) if spelled not in ENDS else spelled
    return ENDS[spelled][1] if spelled in ENDS else read_unit(end)


def _is_compound(name: str, unit: str, gap: str) -> bool:
    """Return whether a unit is the last piece of one that is not known, as mm is of N/mm, and no unit of the name."""
    before = re.split(r"[\s_./,;]+", name)
    piece = before[-1] if len(before) > 1 else ""
    own, kind = read_unit(piece), UNIT_KINDS[unit]
    loose = gap.strip(" _.") == "" and unit == "s"
    return bool(
        ONLY_IN_COMPOUNDS.fullmatch(piece)
        or (piece == "n" and kind == "length")  # a small n is one of force there
        or re.search(r"\bin [\d.,^x-]+$", name)  # a factor, as in ``Kraft in 10 N``
        or (own is not None and piece in (own, own.replace(" ", ""), *OTHER_SPELLINGS))
        or (kind == "time" and (gap == "/" or unit == "min" or loose) and not CLOCK.fullmatch(name))
    )


def check_headings(
    columns: Mapping[str, str | None], units: Mapping[str, str | None], told: Mapping[str, str], present: set[str]
) -> None:
    """Refuse columns whose headings state other units than those in which they would be read.

    Columns and units are those of `adopt`, and a unit that is given is believed; `told` has the units from a row of
    their own, by column of the file. A `RecordingError` names the units to set.
    """
    wrong = []
    for name, column in columns.items():
        source = column or name
        if source not in present or units.get(name) is not None or name in LABELS:
            continue
        heading, own = read_heading(source, told.get(source, "")), own_unit(name)
        if heading.unit is None or heading.unit == own:
            continue
        factor = known_units(name).get(heading.unit)
        same = factor == 1.0 and ZEROS.get(heading.unit) == ZEROS.get(own)
        if same or (factor is None and not heading.plain):
            continue
        key = f"{'' if name in units else '+'}units.{name}"
        try:
            remedy = f"set {assign(key, choose_unit(name, heading.unit))}"
        except ValueError:
            remedy = f"name the signal by its {UNIT_KINDS[heading.unit]}, as NAME_{end_of(heading.unit)}"
        wrong.append(
            f"column {source}: the file states {heading.unit}, and {name} is in {own}; {remedy}, or "
            f"{assign(key, own)} if the file is wrong"
        )
    if wrong:
        raise RecordingError("; ".join(wrong))
