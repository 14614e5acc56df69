"""A recorded file described: what its columns hold, how its clock runs, and how much of each record and part there is.

Columns as they were read flow in, with the map that `guess_map` makes of their headings; lines of text and the
arguments of a command flow out.
"""

import re
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from stages.science.recording.blocks import begins_anew, split_records
from stages.science.recording.clock import are_days, find_epoch_unit, find_rate, goes_on
from stages.science.recording.columns import (
    LEAVE_EMPTY,
    MOST_WORDS,
    TIME,
    RecordingError,
    adopt,
    assign,
    find_mark,
    find_words,
    name_rows,
    quote,
)
from stages.science.recording.dates import is_dates
from stages.science.recording.files.delimited import Header
from stages.science.recording.guessing import Guess, Key, choose_machine, guess_map, pair_parts
from stages.science.recording.headings import read_heading
from stages.science.recording.labels import list_labels, restarts, stays
from stages.science.recording.uneven import FEWEST, count_rounded, is_uneven
from stages.science.recording.units import own_unit
from stages.science.signals.trajectories import Array

TABLE = ("column", "values", "from", "to", "missing", "unit", "taken for")
SIMPLEST = "second_order"
"""Plant that is put into the command, for want of a hint in the file."""
UNTOLD = "NAME"
"""Stands for a signal that the file does not tell."""
FREE = "nothing"
"""Input of a machine that moves by itself, where a file has one signal alone."""
FEW = 12
"""Records or parts that are told one by one."""
OF_ONE = re.compile(r"^(.+)\[[A-Za-z_]\w*\]$")
"""A column of one muscle or joint among others."""


def describe(
    columns: Mapping[str, pd.Series],
    header: Header,
    largest_jitter: float,
    machines: Mapping[str, Mapping[str, Key]],
) -> tuple[list[str], Guess]:
    """Return all that can be told of a file, as lines, and the map that its headings and values make plain.

    A step of time may deviate from whole periods by `largest_jitter` of one. The machines are those that could have
    been recorded: by kind, the keys that name its signals. A `RecordingError` tells that no column has values.
    """
    rows = sorted({len(values) for values in columns.values()})
    if not rows or rows[-1] == 0:
        raise RecordingError("; ".join(["expected columns with values, got none", *header.remarks]))
    unknown = []
    for name, values in columns.items():
        numbers, wrong = find_words(values)
        told = find_mark(values, least=1) if _is_number(values) else ""
        if 0.0 < wrong.mean() <= MOST_WORDS and not stays(values):  # labels may be numbers but for some
            told = f"{str(values[wrong].iloc[0])[:40]!r} in {name_rows(wrong)} is no number"
            columns = {**columns, name: numbers}
        if told:
            unknown.append(f"in {name} {told}: {LEAVE_EMPTY}, so that it counts as missing")
    if not any(_is_number(values) and values.notna().sum() > 1 for values in columns.values()):
        raise RecordingError(f"expected a column of two numbers or more, got none in {', '.join(columns)}")
    guess = _guess_columns(columns, header.units, header.single)
    if not guess.muscles:
        guess.machine = choose_machine(guess, machines)
    lines = [
        f"{len(columns)} columns, {' or '.join(map(str, rows))} rows",
        *(f"  {each}" for each in [*header.remarks, *header.dropped]),
        *(f"  {name} = {value:g}, a single number" for name, value in header.single.items()),
        *("", *_describe_columns(columns, header.units, guess)),
        *("", *_describe_clock(columns, guess, largest_jitter)),
    ]
    time = guess.columns.get(TIME, "")
    counted = time in columns and columns[time].dtype.kind in "iu" and TIME not in guess.units
    if counted and read_heading(time, header.units.get(time, "")).unit is None:
        step = float(columns[time].diff().median())
        unknown.append(f"the unit of {time}, in steps of {step:g}: s is assumed; type units.time_s=ms if it is ms")
    unknown += _describe_unknown(guess, machines)
    return lines + (["", "not told by the file:", *(f"  {each}" for each in unknown)] if unknown else []), guess


def _describe_columns(columns: Mapping[str, pd.Series], units: Mapping[str, str], guess: Guess) -> list[str]:
    """Return a table, as lines: each column's kind of values, range, gaps, unit and what it would be taken for."""
    taken = {column: name for name, column in guess.columns.items()}
    rows = [TABLE]
    for name, values in columns.items():
        unit = read_heading(name, units.get(name, "")).unit or ""
        stem = next((name.removesuffix(end) for end in guess.endings if name.endswith(end)), name)
        low, high = _describe_range(values)
        row = (name, _describe_type(values), low, high, str(int(values.isna().sum())), unit)
        rows.append((*row, taken.get(name) or taken.get(stem, "-")))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    sides = [f"{{:{'>' if k in (2, 3, 4) else '<'}{width}}}" for k, width in enumerate(widths)]
    return ["  ".join(sides).format(*row).rstrip() for row in rows]


def _guess_columns(columns: Mapping[str, pd.Series], units: Mapping[str, str], single: Mapping[str, float]) -> Guess:
    """Return the map that headings and values make plain."""
    numeric = {name: values.dropna().to_numpy(float) for name, values in columns.items() if _is_number(values)}
    constant = {name: float(each[0]) for name, each in numeric.items() if len(each) and (each == each[0]).all()}
    single = {**single, **constant}
    dates = [name for name, values in columns.items() if not _is_number(values) and is_dates(values)]
    filled = {name: values for name, values in columns.items() if values.notna().any()}
    numbers = [name for name, values in filled.items() if _is_number(values) or name in dates]
    texts = [name for name in filled if name not in numbers]
    dates.sort(key=lambda each: -columns[each].nunique())
    steady = [name for name, values in numeric.items() if goes_on(values)]
    guess = guess_map(numbers, texts, units, single, dates, steady)
    epoch = find_epoch_unit(numeric.get(guess.columns.get(TIME, ""), np.zeros(1)))
    if TIME in guess.columns and TIME not in guess.units:
        heading = guess.columns[TIME]
        days = heading in numeric and are_days(numeric[heading], "date" in heading.casefold())
        unit = "d" if days else epoch
        guess.units |= {} if unit is None else {TIME: unit}
    if not guess.muscles and not guess.endings:
        _separate_records(guess, columns)
    if part := guess.columns.get("part"):
        guess.parts = pair_parts([str(each) for each in columns[part].dropna().unique()])
    return guess


def _separate_records(guess: Guess, columns: Mapping[str, pd.Series]) -> None:
    """Take for the record what labels records by its values; a column of that name which does not is none."""
    named, part, time = (guess.columns.get(each) for each in ("record", "part", TIME))
    labels = [each for each in list_labels(columns, time) if each == named or each not in guess.columns.values()]
    if named is None and not labels:  # a load or a gain that was set for each
        labels = [each for each in list_labels(columns, time) if each not in (part, time)]
        for signal in [name for name in guess.signals if guess.columns[name] in labels[:1]]:
            del guess.columns[signal]
            guess.units.pop(signal, None)
    if named is not None and named not in labels and (labels or not stays(columns[named])):
        del guess.columns["record"]
        guess.left += [named] if _is_number(columns[named]) else []
    if named in labels or "record" in guess.columns or not labels:
        return
    if part is None or time is None or restarts(columns, time, part):
        guess.take("record", labels[0])
        guess.left = [each for each in guess.left if each != labels[0]]


def _describe_clock(columns: Mapping[str, pd.Series], guess: Guess, largest_jitter: float) -> list[str]:
    """Return lines on rate, evenness, records and parts; messages where a clock cannot be read."""
    if guess.endings:
        ends = {end: {columns[name].count() for name in columns if name.endswith(end)} for end in guess.endings}
        told = [f"{end} ({' or '.join(map(str, sorted(sizes)))} rows)" for end, sizes in ends.items()]
        return [f"parts, by the ends of names: {', '.join(told)}"]
    chosen = {name: columns[column] for name, column in guess.columns.items() if name not in guess.signals}
    chosen |= {name: columns[guess.columns[name]] for name in ("trial", "muscle") if name in guess.columns}
    frame = pd.DataFrame({str(values.name): values for values in chosen.values()})
    names = [name for name in chosen if name != TIME]
    try:
        found = adopt(frame, {name: guess.columns[name] for name in chosen}, guess.units, names, [])
    except RecordingError as error:
        return [str(error)]
    if TIME in found and not guess.muscles and "record" not in names and begins_anew(found).any():
        found = split_records(found).drop(columns=[] if "part" in names else "part")
        names = [*names, "record"]
    stream = [name for name in names if name != "part"] or (["part"] if "part" in names else [])
    lines = [_describe_groups(found, "trial" if guess.muscles else "record"), _describe_groups(found, "part")]
    if TIME in found:
        lines.insert(0, f"time: {_describe_steps(found, stream, largest_jitter, guess.muscles)}")
    return [each for each in lines if each]


def list_arguments(guess: Guess, defaults: Sequence[str]) -> list[str]:
    """Return the arguments that give a map to the command line; names that no default has are added to it."""
    signals = () if guess.muscles else guess.signals  # which none is, of records, that is not named
    own = {name: column for name, column in guess.columns.items() if name != column or name in signals}
    if len(signals) == 1 and len(guess.left) == 1:  # a machine has two
        own[f"{UNTOLD}_UNIT"] = guess.left[0]
    arguments = [
        f"{'' if name in defaults else '+'}{section}.{name}={quote(value)}"
        for section, entries in (("columns", own), ("units", guess.units))
        for name, value in entries.items()
    ]
    if guess.rate_hz is not None:
        arguments.append(f"measurement.rate_hz={guess.rate_hz:.9g}")
    if guess.endings:
        arguments.append(f"measurement.part_endings=[{','.join(quote(each) for each in guess.endings)}]")
    parts = guess.parts or tuple(each.lstrip("_") for each in guess.endings)
    if parts:
        arguments += [f"parts.fitted=[{quote(parts[0])}]", f"parts.verification=[{quote(parts[1])}]"]
    if not guess.muscles:
        roles = {"input": [guess.input or UNTOLD], "output": [guess.output or UNTOLD]}
        if len(guess.signals) == 1 and not guess.left:
            roles = {"input": [FREE], "output": guess.signals}
        kind, named = guess.machine or (SIMPLEST, roles)
        arguments += [f"plant={kind}", *(_name_signals(key, names or ["null"]) for key, names in named.items())]
    return arguments


def _name_signals(key: str, names: Sequence[str]) -> str:
    """Return the argument by which a key of a machine names its signals."""
    return f"plant.{key}={names[0] if len(names) == 1 else '[' + ','.join(names) + ']'}"


def _describe_unknown(guess: Guess, machines: Mapping[str, Mapping[str, Key]]) -> list[str]:
    """Return what the headings leave open, each with what to type."""
    lines = []
    if TIME not in guess.columns:
        unknown = "which column is time: columns.time_s=NAME; or, without one, its rate: measurement.rate_hz=..."
        assumed = f"time: {guess.rate_hz or 0.0:g} Hz is assumed, from the number that stands alone"
        lines.append(unknown if guess.rate_hz is None else assumed)
    if guess.muscles:
        missing = [name for name in ("trial", "muscle", "pressure_kpa", "force_n") if name not in guess.columns]
        return [*lines, *(f"which column is {name}: columns.{name}=NAME" for name in missing)]
    if not guess.signals and not guess.left:
        lines.append("which columns are signals: +columns.NAME_UNIT=COLUMN, as in +columns.force_n=F +units.force_n=kN")
    if guess.left:
        some = f"{', '.join(guess.left[:FEW])}{', ...' * (len(guess.left) > FEW)}"
        lines.append(f"the unit of {some}, left out: +columns.NAME_UNIT=COLUMN takes one, as in +columns.force_n=F")
    stems = [found.group(1) for each in reversed(guess.left) if (found := OF_ONE.match(each))]
    if stems:
        pattern = assign("columns.force_n", f"{max(stems, key=stems.count)}[{{muscle}}]")
        lines.append(f"which columns are of muscles: {pattern} takes one of each, as muscles")
    for name in guess.assumed:
        lines.append(f"the unit of {guess.columns[name]}: {own_unit(name)} is assumed; end {name} in the right one")
    for does, key, signal in (("drives the machine", "input", guess.input), ("answers", "output", guess.output)):
        if signal is None and (len(guess.signals) > 1 or (guess.signals and guess.left)) and guess.machine is None:
            more = " or what is left out, once it has a name" if len(guess.signals) == 1 else ""
            lines.append(f"which signal {does}: plant.{key}=NAME, of {', '.join(guess.signals)}{more}")
    chosen = guess.machine[0] if guess.machine else SIMPLEST
    others = [
        _describe_machine(guess, kind, keys)
        for kind, keys in machines.items()
        if kind != chosen and (guess.left or _count_needed(keys) <= max(len(guess.signals), 2))
    ]
    why = ", by its quantities" if guess.machine else ""
    return [
        *lines,
        f"which machine it is: plant={chosen} is put here{why}; in place of it and its signals may stand",
        *(f"  {each}" for each in others),
    ]


def _count_needed(keys: Mapping[str, Key]) -> int:
    """Return how many signals a machine takes at least."""
    return sum(count for count, optional, *_ in keys.values() if not optional)


def _describe_machine(guess: Guess, kind: str, keys: Mapping[str, Key]) -> str:
    """Return the arguments that choose a machine, with its signals as far as they are plain."""
    needed = {key: count for key, (count, optional, *_) in keys.items() if not optional}
    rest = [each for each in guess.signals if each != guess.output]
    told = guess.output is not None and len(rest) == _count_needed(keys) - 1
    named = iter(rest if told else [])
    if not told and guess.input and _count_needed(keys) == 2:
        named = iter([guess.input])
    arguments = [f"plant={kind}"]
    for key, count in needed.items():
        signals = [guess.output or UNTOLD] if key == "output" else [next(named, UNTOLD) for _ in range(count)]
        argument = _name_signals(key, signals)
        arguments.append(argument if count == 1 else f"'{argument}'")
    more = [f"plant.{key}={UNTOLD}" for key, (_, optional, *_) in keys.items() if optional]
    more += [f"plant.{key}=null" for key, (_, optional, _, nullable) in keys.items() if nullable and not optional]
    return " ".join(arguments) + (f" [{' '.join(more)}]" if more else "")


def _is_number(values: pd.Series) -> bool:
    return values.dtype.kind in "fiub"


def _describe_type(values: pd.Series) -> str:
    told = {"b": "yes or no", "i": "whole numbers", "u": "whole numbers", "f": "numbers", "m": "durations"}
    return told.get(values.dtype.kind) or ("dates" if is_dates(values) else "text")


def _describe_range(values: pd.Series) -> tuple[str, str]:
    known = values.dropna()
    if known.empty:
        return "", ""
    if _is_number(values):
        return f"{float(known.min()):.6g}", f"{float(known.max()):.6g}"
    if values.dtype.kind in "mM":
        return str(known.min()), str(known.max())
    distinct = known.astype(str).unique()
    return str(distinct[0])[:20], str(distinct[-1])[:20]


def _describe_steps(told: pd.DataFrame, stream: Sequence[str], largest_jitter: float, muscles: bool) -> str:
    told = told.assign(all="")
    records = told.groupby(list(stream) or ["all"], sort=False)[TIME]
    steps = records.diff().dropna()
    if steps.empty:
        return "one sample of each record"
    if (steps < 0.0).any():
        return "goes back; sort the rows or, if a column tells records apart, type columns.record=NAME"
    usual = float(steps.median())
    rounded = None if muscles else _find_rounded([each.to_numpy(dtype=float) for _, each in records], largest_jitter)
    if rounded is not None:
        return f"steps rounded to {rounded[0]:g} s; the samples will be counted, at {rounded[1]:.6g} Hz"
    if usual <= 0.0:
        return "stands still"
    own = records.agg(lambda each: each.diff().median()) if stream else steps[:0]
    rates = 1.0 / own[own > 0.0]
    if len(rates) and max(rates) > 1.01 * min(rates):
        return f"{min(rates):.6g} to {max(rates):.6g} Hz, by record; they are resampled to the lowest"
    whole = (steps / usual).round()
    gaps = int((whole > 1.0).sum())
    uneven = (steps / usual - whole).abs() > largest_jitter * whole.clip(lower=1.0)
    beside = f", but for {gaps} gap{'s' * (gaps > 1)}" if gaps else ""
    rate = f"{find_rate(told, [*stream, 'all'], None):.6g}"
    if not uneven.any():
        return f"even steps, {rate} Hz{beside}"
    return (
        f"uneven steps of {steps.min():.4g} to {steps.max():.4g} s about {usual:.4g} s ({rate} Hz), "
        f"{int(uneven.sum())} of them by more than measurement.largest_jitter; "
        f"{'resample it, or raise that' if muscles else 'they will be put on an even clock'}"
    )


def _find_rounded(times: Sequence[Array], largest_jitter: float) -> tuple[float, float] | None:
    """Return the last digit (s) and the rate (Hz) of a rounded clock, if all records that are uneven have one."""
    times = [its for its in times if len(its) >= FEWEST]
    found = [count_rounded(its) for its in times if np.isfinite(its).all() and is_uneven(its, largest_jitter)]
    rounded = [one for one in found if one is not None]
    return (rounded[0][0], rounded[0][2]) if rounded and len(rounded) == len(found) else None


def _describe_groups(told: pd.DataFrame, name: str) -> str:
    if name not in told:
        return ""
    sizes = told[name].value_counts(sort=False)
    if len(sizes) > FEW:
        least, most = int(sizes.min()), int(sizes.max())
        return f"{name}s: {len(sizes)}, of {least}{f' to {most}' * (most > least)} rows"
    return f"{name}s: " + ", ".join(f"{each} ({count} rows)" for each, count in sizes.items())
