"""The map from a file's columns to this project's, as the configuration gives it.

A file's columns flow in, and the rows read from them; which columns are wanted, where every column comes from, in
words, and rows under this project's names and units flow out, or a `RecordingError`. Parts may stand side by side,
identified by the endings of their columns' names: uEst, yEst, uVal, yVal become u, y and a part. Where each
muscle or joint has a column, patterns such as ``force_{muscle}`` name them, and rows for each muscle and time flow out.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from stages.science.recording.columns import ANOTHER, TIME, RecordingError, adopt
from stages.science.recording.headings import check_headings
from stages.science.recording.units import own_unit

MUSCLE, JOINT = "{muscle}", "{joint}"
Columns = Mapping[str, str | None]


@dataclass(frozen=True)
class ColumnMap:
    """Which column of a file holds which quantity.

    Parameters
    ----------
    columns, units : mapping of str to str or None
        By this project's name, the file's column and its unit; None stands for the name itself and its own unit. A
        column may be a pattern with ``{muscle}`` or ``{joint}``.
    texts, needed : sequence of str
        This project's names whose values are text, and those that must be there.
    endings : sequence of str
        Endings of the file's column names that identify parts; empty where none do.
    rate_hz : float or None
        Samples per second, for a file without a column of time.
    muscles : DataFrame
        With ``muscle`` and ``joint``, for which patterns stand.
    """

    columns: Columns
    units: Columns
    texts: Sequence[str]
    needed: Sequence[str]
    endings: Sequence[str]
    rate_hz: float | None
    muscles: pd.DataFrame

    @property
    def sources(self) -> dict[str, str]:
        """The file's column of every name."""
        return {name: column or name for name, column in self.columns.items()}

    @property
    def wanted(self) -> list[str]:
        """The file's columns that may be read."""
        return _list_sources(self.sources.values(), self.muscles)

    def part_columns(self, names: Sequence[str]) -> dict[str, dict[str, str]]:
        """Return for each ending the file's columns and their names without it, as far as they are wanted.

        A column without any of the endings belongs to all parts. A `RecordingError` tells an ending of no column.
        """
        wanted, found = list(self.sources.values()), {}
        for end in self.endings:
            own = {f"{name}{end}": name for name in wanted if f"{name}{end}" in names}
            if not own:
                raise RecordingError(
                    f"measurement.part_endings: expected columns such as {wanted[0]}{end}, got none that is mapped and "
                    f"ends in {end}; there are: {', '.join(names)}"
                )
            found[end] = own | {name: name for name in wanted if name in names and name not in own.values()}
        return found

    def list_columns(self, names: Sequence[str]) -> list[str]:
        """Return the columns that a file gives, those that the ends of their names tell apart under one name."""
        if not self.endings:
            return list(names)
        return list(dict.fromkeys(name for part in self.part_columns(names).values() for name in part.values()))

    def counts_samples(self, names: Sequence[str]) -> bool:
        """Return whether time follows from the rate, as a file has no column of it."""
        return self.rate_hz is not None and self.sources[TIME] not in self.list_columns(names)

    def adopt(self, frame: pd.DataFrame, names: Sequence[str], stated_units: Mapping[str, str]) -> pd.DataFrame:
        """Return this project's columns of a file's rows, a row for each muscle and time where the file is wide.

        The frame has the columns that the map names, `names` all of the file, and the stated units are from a row of
        their own. Raises as `columns.adopt` and `check_headings`, and a `RecordingError` where there are no rows.
        """
        columns = {**self.columns, **({"part": "part"} if self.endings else {})}
        for muscle in _list_muscles(self.muscles):
            own = {name: column and _expand(column, *muscle) for name, column in columns.items()}
            check_headings(own, self.units, stated_units, set(names))
        if not len(frame.columns):
            wanted = ", ".join(self.sources[name] for name in self.needed)
            another = ANOTHER if "muscle" in self.needed else ""
            raise RecordingError(f"expected columns {wanted}, got {', '.join(names)}{another}")
        if frame.empty:
            raise RecordingError("expected samples, got no rows")
        known = [*dict.fromkeys([*names, *map(str, frame.columns)])]
        if is_wide(columns):
            frame = _lengthen(frame, columns, self.muscles)
        return adopt(frame, columns, self.units, self.texts, self.needed, known)

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
        taken = _list_sources([self.sources[name] for name in wanted], self.muscles)
        taken += [f"{name}{end}" for name in taken for end in self.endings]
        unused = [name for name in names if name not in taken]
        return [*lines, f"left alone: {', '.join(unused)}"] if unused else lines

    def _describe_origin(self, name: str, given: Sequence[str]) -> str:
        source = self.sources[name]
        stated = _list_sources([source], self.muscles)
        absent = [each for each in stated if each not in given]
        if absent and len(absent) == len(stated):
            return f"MISSING ({source}); say which with columns.{name}=NAME"
        source += f", without {', '.join(absent)}" if absent else ""
        unit, own = self.units.get(name), own_unit(name)
        return f"{source}, {unit} -> {own}" if unit and unit != own else source


def join_parts(frames: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Return the rows of all parts, each with its ending as ``part``; empty rows at a part's end are left out."""
    joined = []
    for end, frame in frames.items():
        present = frame.notna().any(axis=1).to_numpy()
        last = len(frame) - int(present[::-1].argmax()) if present.any() else 0
        joined.append(frame.iloc[:last].assign(part=end.strip("_- .")))
    return pd.concat(joined, ignore_index=True)


def is_wide(columns: Columns) -> bool:
    """Return whether some column of a map is a pattern."""
    return any(column is not None and (MUSCLE in column or JOINT in column) for column in columns.values())


def is_one_trial(columns: Columns, names: Collection[str]) -> bool:
    """Return whether a file with these columns is one trial, as it is wide and nothing in it numbers trials."""
    return is_wide(columns) and "trial" in columns and columns["trial"] is None and "trial" not in names


def _expand(column: str, muscle: str, joint: str) -> str:
    """Return the column of a muscle that a pattern stands for; any other column stands for itself."""
    return column.replace(MUSCLE, muscle).replace(JOINT, joint)


def _list_muscles(muscles: pd.DataFrame) -> list[tuple[str, str]]:
    return list(zip(muscles["muscle"], muscles["joint"], strict=True))


def _list_sources(columns: Iterable[str], muscles: pd.DataFrame) -> list[str]:
    """Return columns, and in the place of each pattern all that it stands for."""
    return list(dict.fromkeys(_expand(each, *muscle) for each in columns for muscle in _list_muscles(muscles)))


def _lengthen(frame: pd.DataFrame, columns: Columns, muscles: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of every muscle behind each other, under the names that the map has, patterns among them.

    The index counts the rows of the file; one that has no column of trials is one trial.
    """
    patterns = [each for each in columns.values() if each and is_wide({"": each})]
    spent = set(_list_sources(patterns, muscles))
    shared = frame[[name for name in frame if name not in spent]]
    if is_one_trial(columns, list(map(str, frame))):
        shared = shared.assign(trial=0)
    long = []
    for muscle in _list_muscles(muscles):
        told = {each: frame[source] for each in patterns if (source := _expand(each, *muscle)) in frame}
        long.append(shared.assign(**{columns.get("muscle") or "muscle": muscle[0]}, **told))
    return pd.concat(long)
