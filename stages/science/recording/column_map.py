"""The map from a foreign file's columns to this project's, as the configuration gives it.

The file's columns flow in; which of them are wanted, and where every column comes from, in words, flow out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from stages.science.recording.columns import TIME
from stages.science.recording.endings import name_parts
from stages.science.recording.units import own_unit
from stages.science.recording.wide import is_one_trial, is_pattern, is_wide, list_sources


@dataclass(frozen=True)
class ColumnMap:
    """Which foreign column is what.

    Parameters
    ----------
    columns, units : mapping of str to str or None
        By this project's name, the foreign column and its unit; None stands for the name itself and its own unit.
    needed : sequence of str
        This project's names that must be there.
    endings : sequence of str
        Ends of the foreign names that tell parts; empty where none do.
    rate_hz : float or None
        Samples per second, for a file without a column of time.
    muscles : DataFrame
        With ``muscle`` and ``joint``, for which patterns stand.
    """

    columns: Mapping[str, str | None]
    units: Mapping[str, str | None]
    needed: Sequence[str]
    endings: Sequence[str]
    rate_hz: float | None
    muscles: pd.DataFrame

    @property
    def sources(self) -> dict[str, str]:
        """The foreign column of every name."""
        return {name: column or name for name, column in self.columns.items()}

    @property
    def wanted(self) -> list[str]:
        """The foreign columns that may be read."""
        return list_sources(self.sources.values(), self.muscles)

    def part_columns(self, names: Sequence[str]) -> dict[str, dict[str, str]]:
        """Return as `name_parts`, of a file's columns."""
        return name_parts(list(self.sources.values()), names, self.endings)

    def list_columns(self, names: Sequence[str]) -> list[str]:
        """Return the columns that a file gives, those that the ends of their names tell apart under one name."""
        if not self.endings:
            return list(names)
        return list(dict.fromkeys(name for part in self.part_columns(names).values() for name in part.values()))

    def counts_samples(self, names: Sequence[str]) -> bool:
        """Return whether time follows from the rate, as a file has no column of it."""
        return self.rate_hz is not None and self.sources[TIME] not in self.list_columns(names)

    def describe(self, names: Sequence[str]) -> list[str]:
        """Return a line for each column: where it comes from, and in which unit; then what is not used."""
        given = self.list_columns(names)
        spared = {"muscle"} if is_wide(self.columns) else set()
        spared |= {"trial"} if is_one_trial(self.columns, given) else set()
        needed = [name for name in self.needed if name not in spared]
        wanted = [name for name in self.columns if self.columns[name] or name in given or name in needed]
        absent = [name for name in self.columns if name not in wanted]
        lines = [f"{name:<26} <- {self._describe_origin(name, given)}" for name in wanted]
        if self.endings:
            lines.append(f"{'part':<26} <- ends of names: {', '.join(self.endings)}")
        if self.counts_samples(names):
            lines.append(f"{TIME:<26} <- counted, {self.rate_hz:g} Hz")
        if "trial" in spared:
            lines.append(f"{'trial':<26} <- the whole file is one, number 0")
        if absent:
            lines.append(f"not there, not needed: {', '.join(absent)}")
        taken = list_sources([self.sources[name] for name in wanted], self.muscles)
        taken += [f"{name}{end}" for name in taken for end in self.endings]
        unused = [name for name in names if name not in taken]
        return [*lines, f"left alone: {', '.join(unused)}"] if unused else lines

    def _describe_origin(self, name: str, given: Sequence[str]) -> str:
        source = self.sources[name]
        absent = [each for each in list_sources([source], self.muscles) if each not in given]
        if absent and (not is_pattern(source) or set(absent) == set(list_sources([source], self.muscles))):
            return f"MISSING ({source}); say which with columns.{name}=NAME"
        source += f", without {', '.join(absent)}" if absent else ""
        unit, own = self.units.get(name), own_unit(name)
        return f"{source}, {unit} -> {own}" if unit and unit != own else source
