"""The map from a foreign file's columns to this project's, as the configuration gives it.

The file's columns flow in; which of them are wanted, and where every column comes from, in words, flow out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from stages.recording.columns import TIME
from stages.recording.endings import name_parts
from stages.recording.units import own_unit


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
    """

    columns: Mapping[str, str | None]
    units: Mapping[str, str | None]
    needed: Sequence[str]
    endings: Sequence[str]
    rate_hz: float | None

    @property
    def sources(self) -> dict[str, str]:
        """The foreign column of every name."""
        return {name: column or name for name, column in self.columns.items()}

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
        wanted = [name for name in self.columns if self.columns[name] or name in given or name in self.needed]
        absent = [name for name in self.columns if name not in wanted]
        lines = [f"{name:<26} <- {self._tell_origin(name, given)}" for name in wanted]
        if self.endings:
            lines.append(f"{'part':<26} <- ends of names: {', '.join(self.endings)}")
        if self.counts_samples(names):
            lines.append(f"{TIME:<26} <- counted, {self.rate_hz:g} Hz")
        if absent:
            lines.append(f"not there, not needed: {', '.join(absent)}")
        taken = [self.sources[name] for name in wanted]
        taken += [f"{name}{end}" for name in taken for end in self.endings]
        unused = [name for name in names if name not in taken]
        return [*lines, f"left alone: {', '.join(unused)}"] if unused else lines

    def _tell_origin(self, name: str, given: Sequence[str]) -> str:
        source = self.sources[name]
        if source not in given:
            return f"MISSING ({source}); say which with columns.{name}=NAME"
        unit, own = self.units.get(name), own_unit(name)
        return f"{source}, {unit} -> {own}" if unit and unit != own else source
