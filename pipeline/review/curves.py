"""Learning curves and the like over many runs: their tables flow in, lines with bands flow out.

Runs that differ in seeds alone are repeats of each other: what they hold is one line, and the band over it is the 95 %
interval of the mean (t) over all that repeats, runs and what the workflow names in each.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from pipeline.flat import is_incidental, is_seed, list_differences
from pipeline.ledger import Ledger
from pipeline.printing import add_unit, join_some, shorten
from pipeline.review.kept import list_tables, read_whole_table, read_workflow
from pipeline.sweeps.sweep_table import split_overrides

if TYPE_CHECKING:
    from pipeline.config import Curve

NOT_SET = "not set"
LONGEST_VALUE = 24
CONFIDENCE = 0.95


class Line(NamedTuple):
    """One series of a curve: what tells it from the others, the runs that it is made of, and its points.

    These have columns ``x``, ``mean``, ``half`` (half of the 95 % interval; nan where nothing repeats) and ``n``.
    """

    label: str
    runs: list[str]
    points: pd.DataFrame


class Curves(NamedTuple):
    """All series of one declared curve, in the order of the runs; its axes with units, and what lines and bands are.

    No value of y is below the `floor`, minus infinity where none is known.
    """

    name: str
    x: str
    y: str
    lines: list[Line]
    told: str
    floor: float


def half_width(spread: pd.Series, count: pd.Series) -> pd.Series:
    """Return half of the 95 % interval (t) of means, from SD and number of their values; nan for fewer than two."""
    from scipy.special import stdtrit

    half: pd.Series = spread * stdtrit(count - 1, (1 + CONFIDENCE) / 2) / np.sqrt(count)
    return half


def find_interval(mean: Any, half: Any, floor: float) -> tuple[Any, Any]:
    """Return the ends of 95 % intervals of means, of which none is below what the values can be."""
    return np.maximum(mean - half, floor), mean + half


def _name_groups(configs: Sequence[Mapping[str, str]], groups: Sequence[int]) -> dict[int, str]:
    """Return for each group what tells it from the others in what is given of each run."""
    firsts = {group: _select_meaningful(config) for group, config in reversed([*zip(groups, configs, strict=True)])}
    keys = list_differences(list(firsts.values()))
    ends = [key.rpartition(".")[2] for key in keys]
    short = {key: end if ends.count(end) == 1 else key for key, end in zip(keys, ends, strict=True)}
    return {
        group: join_some([f"{short[key]}={shorten(config.get(key, NOT_SET), LONGEST_VALUE)}" for key in keys], 3)
        for group, config in sorted(firsts.items())
    }


def make_curves(
    ledgers: Sequence[Ledger], nested: Sequence[Mapping[str, Any]], flat: Sequence[Mapping[str, str]]
) -> tuple[list[Curves], list[str]]:
    """Return the curves that the workflows of runs, given with their configurations, declare and some run holds.

    Returned, too, is why another one is not there.
    """
    from pydantic import ValidationError

    from pipeline.config import Curve

    declared: dict[str, Curve] = {}
    complaints = []
    for config in nested:
        for name, values in read_workflow(config, "curves", dict).items():
            try:
                declared.setdefault(str(name), Curve.model_validate(values))
            except ValidationError:
                complaints.append(f"curve {name}: not declared as this version reads it")
    kinds: dict[tuple[tuple[str, str], ...], int] = {}
    groups = [kinds.setdefault(tuple(sorted(_select_meaningful(each).items())), len(kinds)) for each in flat]
    labels = _name_groups([_read_overrides(each) for each in ledgers], groups)  # by what was typed, where that tells
    if len(set(labels.values())) < len(labels):
        labels = _name_groups(flat, groups)
    told = list(labels.values())
    labels = {group: f"{name} (group {group + 1})" if told.count(name) > 1 else name for group, name in labels.items()}
    curves = []
    for name, curve in declared.items():
        try:
            made = _make(name, curve, ledgers, groups, labels)
        except (KeyError, TypeError, ValueError):
            complaints.append(f"curve {name}: table {curve.table} lacks a column that it names, or numbers in it")
            continue
        if made is None:
            complaints.append(f"curve {name}: none of the runs has rows of it in table {curve.table}")
        else:
            curves.append(made)
    return curves, list(dict.fromkeys(complaints))


def _make(
    name: str, curve: Curve, ledgers: Sequence[Ledger], groups: Sequence[int], labels: dict[int, str]
) -> Curves | None:
    frames: dict[int, dict[str, pd.DataFrame]] = {}
    seen: set[tuple[int, str]] = set()
    twins = []
    units: dict[str, str] = {}
    floor = -np.inf
    for ledger, group in zip(ledgers, groups, strict=True):
        kept = list_tables(ledger).get(curve.table)
        read = read_whole_table(ledger, curve.table) if kept else None
        if kept is None or read is None:
            continue
        if (group, kept["sha256"]) in seen:
            twins.append(ledger.name)
            continue
        seen.add((group, kept["sha256"]))
        frame, units = average_repeats(read[0], curve), read[1]
        floor = kept.get("low", {}).get(curve.y, floor)
        if not frame.empty:
            frames.setdefault(group, {})[ledger.name] = frame
    same: dict[tuple[str, bytes], list[tuple[int, list[str], pd.DataFrame]]] = {}
    for group, found in frames.items():
        for value, points in split_series(pd.concat(found.values()), curve):
            same.setdefault((value, points.to_numpy().tobytes()), []).append((group, [*found], points))
    if not same:
        return None
    lines = []
    for (value, _), those in same.items():  # such as a control, which does not have what groups differ in
        named = " = ".join(labels[group] for group, _, _ in those) if len(those) < len(frames) or not value else ""
        runs = [run for _, found, _ in those for run in found]
        lines.append(Line(", ".join(filter(None, (value, named))) or curve.y, runs, those[0][2]))
    where = "".join(f", {key} {value}" for key, value in curve.where.items())
    repeats = " x ".join(["runs", *(f"{each}s" for each in curve.repeats)])
    told = f"{curve.y} over {curve.x} from table {curve.table}{where}. "
    told += f"Lines are means, bands 95 % intervals of the mean (t) over {repeats}; a line without band has n = 1"
    told += ", a band may be wider than the frame"
    if twins:
        told += f"; counted once, as its table is that of another run to the byte: {', '.join(twins)}"
    x = add_unit(curve.x, units.get(curve.x, "1"))
    return Curves(name, x, add_unit(curve.title or curve.y, units.get(curve.y, "1")), lines, told, floor)


def average_repeats(frame: pd.DataFrame, curve: Curve) -> pd.DataFrame:
    """Return one value of y for each repeat, series and x of a run."""
    for column, value in curve.where.items():
        frame = frame[frame[column].isin(value if isinstance(value, list) else [value])]
    keys = list(dict.fromkeys([*curve.by, *curve.repeats, curve.x]))
    found = frame[[*keys, curve.y]].dropna()
    found = found.assign(**{curve.y: found[curve.y].astype(float), curve.x: found[curve.x].astype(float)})
    return found.groupby(keys, sort=False)[curve.y].mean().reset_index()


def split_series(frame: pd.DataFrame, curve: Curve) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield what tells a series from the others of its runs, and its points."""
    for values, part in frame.groupby(curve.by, sort=False) if curve.by else [((), frame)]:
        found = part.groupby(curve.x)[curve.y].agg(["mean", "std", "count"]).reset_index(names="x")
        points = found.assign(half=half_width(found["std"], found["count"]), n=found["count"])
        yield ", ".join(f"{column} {value}" for column, value in zip(curve.by, values, strict=True)), points


def _read_overrides(ledger: Ledger) -> dict[str, str]:
    try:
        return split_overrides(shlex.split(str(ledger.facts["command"])))
    except ValueError:
        return {}


def _select_meaningful(config: Mapping[str, str]) -> dict[str, str]:
    return {key: value for key, value in config.items() if not is_seed(key) and not is_incidental(key)}
