"""Learning curves and the like over many runs: their tables flow in, lines with bands flow out.

Runs that differ in seeds alone are repeats of each other: what they hold is one line, and the band over it is the 95 %
interval of the mean (t) over all that repeats, runs and what the workflow names in each.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from pipeline.flat import INCIDENTAL, is_seed, list_differences
from pipeline.ledger import Ledger
from pipeline.printing import add_unit, join_some, shorten
from pipeline.review.kept import list_tables, read_whole_table
from pipeline.review.pictures import half_width
from pipeline.sweeps.sweep_table import split_overrides

if TYPE_CHECKING:
    from pipeline.config import Curve

SHOWN = ("workflow.headline", "workflow.metrics", "workflow.curves", "workflow.quoted")
"""Sections that say how a run is told, not what it computes."""
NOT_SET = "not set"
LONGEST_VALUE = 24


@dataclass(frozen=True)
class Line:
    """One series of a curve.

    Parameters
    ----------
    label : str
        What tells it from the others.
    runs : tuple of str
        That it is made of.
    points : DataFrame
        Columns ``x``, ``mean``, ``half`` (half of the 95 % interval; nan where nothing repeats) and ``n``.
    """

    label: str
    runs: tuple[str, ...]
    points: pd.DataFrame


@dataclass(frozen=True)
class Curves:
    """All series of one declared curve.

    Parameters
    ----------
    name : str
        As declared.
    x, y : str
        What the axes are, with units.
    lines : tuple of Line
        In the order of the runs.
    told : str
        What the lines and their bands are.
    """

    name: str
    x: str
    y: str
    lines: tuple[Line, ...]
    told: str


def is_incidental(key: str) -> bool:
    """Return whether runs that differ in a key compute the same nevertheless."""
    parts = key.split(".")
    return parts[0] in (*INCIDENTAL, "stages") or ".".join(parts[:2]) in SHOWN


def group_runs(configs: Sequence[Mapping[str, str]]) -> list[int]:
    """Return for each run which group it is of: runs of a group differ in seeds alone.

    Parameters
    ----------
    configs : sequence of mapping
        Flat configuration of each run.
    """
    kinds: dict[tuple[tuple[str, str], ...], int] = {}
    return [kinds.setdefault(tuple(sorted(_select_meaningful(each).items())), len(kinds)) for each in configs]


def name_groups(
    typed: Sequence[Mapping[str, str]], configs: Sequence[Mapping[str, str]], groups: Sequence[int]
) -> dict[int, str]:
    """Return for each group what tells it from the others: what was typed, where that does, else the configuration.

    Parameters
    ----------
    typed : sequence of mapping
        Overrides of each run.
    configs : sequence of mapping
        Flat configuration of each run.
    groups : sequence of int
        From `group_runs`.
    """
    by_typed, by_config = (_name_groups(each, groups) for each in (typed, configs))
    named = by_typed if len(set(by_typed.values())) == len(by_typed) else by_config
    names = list(named.values())
    return {group: f"{name} (group {group + 1})" if names.count(name) > 1 else name for group, name in named.items()}


def _name_groups(configs: Sequence[Mapping[str, str]], groups: Sequence[int]) -> dict[int, str]:
    firsts = {group: _select_meaningful(config) for group, config in reversed([*zip(groups, configs, strict=True)])}
    keys = list_differences(list(firsts.values()))
    ends = [key.rpartition(".")[2] for key in keys]
    short = {key: end if ends.count(end) == 1 else key for key, end in zip(keys, ends, strict=True)}
    named = {}
    for group, config in firsts.items():
        parts = [f"{short[key]}={shorten(config.get(key, NOT_SET), LONGEST_VALUE)}" for key in keys]
        named[group] = join_some(parts, 3)
    return dict(sorted(named.items()))


def make_curves(
    ledgers: Sequence[Ledger],
    names: Sequence[str],
    nested: Sequence[Mapping[str, Any]],
    flat: Sequence[Mapping[str, str]],
) -> tuple[list[Curves], list[str]]:
    """Return every curve that the runs' workflows declare.

    Parameters
    ----------
    ledgers, names : sequence
        The runs, and what each is called.
    nested, flat : sequence of mapping
        Their configurations.

    Returns
    -------
    curves : list of Curves
        Those that some run holds.
    complaints : list of str
        Why another is not there.
    """
    from pydantic import ValidationError

    from pipeline.config import Curve

    declared: dict[str, Curve] = {}
    complaints = []
    for config in nested:
        workflow = config.get("workflow")
        found = workflow.get("curves") if isinstance(workflow, dict) else None
        for name, values in (found if isinstance(found, dict) else {}).items():
            try:
                declared.setdefault(str(name), Curve.model_validate(values))
            except ValidationError:
                complaints.append(f"curve {name}: not declared as this version reads it")
    groups = group_runs(flat)
    labels = name_groups([_read_overrides(each) for each in ledgers], flat, groups)
    curves = []
    for name, curve in declared.items():
        try:
            made = _make(name, curve, ledgers, names, groups, labels)
        except (KeyError, TypeError, ValueError):
            complaints.append(f"curve {name}: table {curve.table} lacks a column that it names, or numbers in it")
            continue
        if made is None:
            complaints.append(f"curve {name}: none of the runs has rows of it in table {curve.table}")
        else:
            curves.append(made)
    return curves, list(dict.fromkeys(complaints))


def _make(
    name: str,
    curve: Curve,
    ledgers: Sequence[Ledger],
    names: Sequence[str],
    groups: Sequence[int],
    labels: dict[int, str],
) -> Curves | None:
    frames: dict[int, list[pd.DataFrame]] = {}
    runs: dict[int, list[str]] = {}
    seen: dict[tuple[int, str], str] = {}
    twins = []
    units: dict[str, str] = {}
    for ledger, run, group in zip(ledgers, names, groups, strict=True):
        kept = list_tables(ledger).get(curve.table)
        read = read_whole_table(ledger, curve.table) if kept else None
        if kept is None or read is None:
            continue
        if (group, kept["sha256"]) in seen:
            twins.append(run)
            continue
        seen[group, kept["sha256"]] = run
        frame, units, _ = read
        frame = _average(frame, curve)
        if not frame.empty:
            frames.setdefault(group, []).append(frame)
            runs.setdefault(group, []).append(run)
    lines = [
        Line(", ".join(each for each in (value, labels[group]) if each) or curve.y, tuple(runs[group]), points)
        for group, found in frames.items()
        for value, points in _split(pd.concat(found), curve)
    ]
    if not lines:
        return None
    where = "".join(f", {key} {value}" for key, value in curve.where.items())
    repeats = " x ".join(["runs", *(f"{each}s" for each in curve.repeats)])
    told = f"{curve.y} over {curve.x} from table {curve.table}{where}. "
    told += f"Lines are means, bands 95 % intervals of the mean (t) over {repeats}; a line without band has n = 1"
    if twins:
        told += f"; counted once, as its table is that of another run to the byte: {', '.join(twins)}"
    return Curves(
        name, add_unit(curve.x, units.get(curve.x, "1")), add_unit(curve.y, units.get(curve.y, "1")), tuple(lines), told
    )


def _average(frame: pd.DataFrame, curve: Curve) -> pd.DataFrame:
    """Return one value of y for each repeat, series and x of a run."""
    for column, value in curve.where.items():
        frame = frame[frame[column].isin(value if isinstance(value, list) else [value])]
    keys = list(dict.fromkeys([*curve.by, *curve.repeats, curve.x]))
    found = frame[[*keys, curve.y]].dropna()
    found = found.assign(**{curve.y: found[curve.y].astype(float), curve.x: found[curve.x].astype(float)})
    return found.groupby(keys, sort=False)[curve.y].mean().reset_index()


def _split(frame: pd.DataFrame, curve: Curve) -> list[tuple[str, pd.DataFrame]]:
    if not curve.by:
        return [("", _band(frame, curve))]
    lines = []
    for values, part in frame.groupby(curve.by, sort=False):
        told = (f"{column} {value}" for column, value in zip(curve.by, _as_tuple(values), strict=True))
        lines.append((", ".join(told), _band(part, curve)))
    return lines


def _as_tuple(values: Any) -> tuple[Any, ...]:
    return values if isinstance(values, tuple) else (values,)


def _band(frame: pd.DataFrame, curve: Curve) -> pd.DataFrame:
    found = frame.groupby(curve.x)[curve.y].agg(["mean", "std", "count"]).reset_index()
    half = np.array([half_width(spread, count) for spread, count in zip(found["std"], found["count"], strict=True)])
    return pd.DataFrame({"x": found[curve.x], "mean": found["mean"], "half": half, "n": found["count"]})


def _read_overrides(ledger: Ledger) -> dict[str, str]:
    try:
        return split_overrides(shlex.split(str(ledger.facts["command"])))
    except ValueError:
        return {}


def _select_meaningful(config: Mapping[str, str]) -> dict[str, str]:
    return {key: value for key, value in config.items() if not is_seed(key) and not is_incidental(key)}
