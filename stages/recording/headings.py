"""What the heading of a foreign column says: the quantity's name, its unit, and whether that fits the column's use.

Headings flow in, with units from a row of their own; names and units flow out, or a `RecordingError`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import NamedTuple

from stages.recording.columns import RecordingError
from stages.recording.units import ENDS, ZEROS, choose_unit, end_of, find_kind, known_units, own_unit, read_unit

BRACKETED = re.compile(r"^(.*?)\s*[\[({]\s*([^\[({\])}]+?)\s*[\])}]\s*$")
BEHIND_A_SIGN = re.compile(r"^(.*\S)(?:\s*[/,;]\s*|\s+in\s+)(\S+)$")
NAMES_BESIDES = ("k", "g", "w", "a")
"""Letters that end more names than they state units."""


class Heading(NamedTuple):
    """Quantity and unit, which is `plain` where it was set apart or is more than one letter."""

    name: str
    unit: str | None
    plain: bool


def read_heading(text: str, told: str = "") -> Heading:
    """Return what a heading says.

    Parameters
    ----------
    text : str
        The column's name, such as ``Force (kN)``, ``p1_kPa`` or ``v_m_s``.
    told : str
        Its unit from a row of units, if there is one.
    """
    if told and (unit := read_unit(told)) is not None:
        return Heading(read_heading(text).name, unit, True)
    for pattern in (BRACKETED, BEHIND_A_SIGN):
        found = pattern.match(text)
        if found and (unit := read_unit(found.group(2))) is not None:
            return Heading(found.group(1), unit, True)
    words = [each for each in re.split(r"[_\s.]+", text) if each]
    for count in range(min(4, len(words) - 1), 0, -1):
        end = "_".join(words[-count:]).lower()
        end = end if end in ENDS else re.sub(r"_s(2?)$", r"_per_s\1", end)
        if end in ENDS and end not in NAMES_BESIDES:
            return Heading("_".join(words[:-count]), ENDS[end][1], len(end) > 1)
    return Heading(text, None, False)


def check_headings(
    columns: Mapping[str, str | None], units: Mapping[str, str | None], told: Mapping[str, str], present: set[str]
) -> None:
    """Refuse a column whose heading states another unit than the one in which it would be read.

    Parameters
    ----------
    columns, units : mapping of str to str or None
        As of `adopt`; a unit that is given is believed.
    told : mapping of str to str
        Units from a row of their own, by foreign column.
    present : set of str
        Foreign columns that are there.

    Raises
    ------
    RecordingError
        Naming the unit to set.
    """
    for name, column in columns.items():
        source = column or name
        if source not in present or units.get(name) is not None:
            continue
        heading, own = read_heading(source, told.get(source, "")), own_unit(name)
        if heading.unit is None or heading.unit == own:
            continue
        if heading.unit in known_units(name):
            if known_units(name)[heading.unit] == 1.0 and ZEROS.get(heading.unit) == ZEROS.get(own):
                continue
        elif not heading.plain:
            continue
        key = f"{'' if name in units else '+'}units.{name}"
        try:
            remedy = f"set {key}={choose_unit(name, heading.unit)}"
        except ValueError:
            remedy = f"name the signal by its {find_kind(heading.unit)}, as NAME_{end_of(heading.unit)}"
        raise RecordingError(
            f"column {source}: the file states {heading.unit}, and {name} is in {own}; {remedy}, or {key}={own} if "
            "the file is wrong"
        )
