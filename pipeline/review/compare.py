"""Runs beside each other: their folders flow in, what tells them apart flows out, as text and as a page with curves."""

import argparse
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
from rich.console import Console

from pipeline.command import review_line
from pipeline.errors import ConfigError, PipelineError, suggest
from pipeline.files import hash_json
from pipeline.flat import ABSENT, flatten, is_incidental, list_differences
from pipeline.ledger import Ledger
from pipeline.page import Block, Section, make_details, make_grid, make_rows, write_page
from pipeline.printing import (
    add_unit,
    format_count,
    format_range,
    format_value,
    is_prose,
    join_some,
    print_frame,
    shorten,
    show_metric,
)
from pipeline.review.curves import Curves, find_interval, make_curves
from pipeline.review.kept import (
    list_headlines,
    list_tables,
    read_config,
    read_slices,
    read_surroundings,
    read_whole_table,
)
from pipeline.runs import find_run, list_ledgers, live_status
from pipeline.terminal import say

COLUMNS_OF_A_TERMINAL = 6
LONGEST_FILE_NAME = 80
STRANGE = re.compile(r"[^\w.=+-]+")
LONGEST_NAME = 24
LONGEST_VALUE = 160
MOST_COLUMNS = 30
MOST_ROWS = 400
"""Rows up to which differences of a table are listed."""
SEEN_FIRST, MOST_SEEN = 3, 6
"""Runs, configuration and metrics; of what follows, what has more rows is a line on the terminal, unless asked for."""


def review(options: argparse.Namespace, console: Console) -> None:
    """Print how runs differ, and write a page of it, with their curves.

    It raises `PipelineError` where names do not mean two runs or more, or the page cannot be written.
    """
    names = options.runs
    found = Comparison(_choose_runs(options.outputs, names), options.all)
    curves, complaints = make_curves(found.ledgers, found.nested, found.flat)
    for place, each in enumerate(replace(found, most=COLUMNS_OF_A_TERMINAL).differences()):
        rows = options.rows or (MOST_ROWS if place < SEEN_FIRST else MOST_SEEN)
        left_out = len(each.frame) > rows and not options.rows
        if each.frame.empty or left_out:
            say(f"{each.title} (--rows {len(each.frame)} shows them)" if left_out else each.title, console)
        else:
            print_frame(each.title, each.frame, console, rows, "--rows")
    for told in complaints:
        say(told, console)
    joined = "_vs_".join(STRANGE.sub("-", each).strip("-") for each in names)
    file = f"compare-{joined if len(joined) <= LONGEST_FILE_NAME else hash_json(list(names))[:12]}.html"
    path = Path(options.html) if options.html else Path(options.outputs) / "reviews" / file
    if not path.name:
        raise PipelineError(f"cannot write {path}: Is a directory; name another file by --html PATH")
    part = "Everything is listed." if options.all else "What is the same in all runs is left out (--all lists it)."
    runs, configuration, metrics, *others = found.differences()
    rest = [make_details(each.title, _show_grid(each.frame)) for each in others]
    shown = [
        Section("What differs", [block for each in (configuration, metrics) for block in _show_difference(each)]),
        Section("Curves", _show_curves(curves, complaints)),
        Section("Tables, code and machines", rest),
        Section("Runs", _show_difference(runs)),
    ]
    named = ", ".join(names)
    try:
        write_page(
            path,
            title=f"compare {named}",
            heading="Comparison",
            lead=f"{named}: {len(found.ledgers)} runs. {part}",
            status="",
            opening=[],
            sections=shown,
        )
    except OSError as error:
        raise PipelineError(f"cannot write {path}: {error.strerror}; name another file by --html PATH") from None
    say(f"page: {path}", console)


def _show_difference(found: "Difference") -> list[Block]:
    return [("heading", found.title[:1].upper() + found.title[1:]), *_show_grid(found.frame)]


def _show_grid(frame: pd.DataFrame) -> list[Block]:
    return [] if frame.empty else [("grid", make_grid(frame))]


def _show_curves(curves: Sequence[Curves], complaints: Sequence[str]) -> list[Block]:
    from pipeline.review.drawing import draw_curves

    blocks: list[Block] = [("pictures", [draw_curves(each) for each in curves])] if curves else []
    blocks += [make_details(f"{each.name}: first and last points", [("grid", _list_lines(each))]) for each in curves]
    blocks += [("note", f"{each}.") for each in complaints]
    note = "Runs that differ in seeds alone are repeats: together they are one line."
    return [("note", note), *blocks] if blocks else []


def _list_lines(curves: Curves) -> dict[str, Any]:
    rows = []
    for line in curves.lines:
        row = [line.label, format_range(line.points["n"]), len(line.runs)]
        for _, point in line.points.iloc[[0, -1]].iterrows():
            low, high = find_interval(point["mean"], point["half"], curves.floor)
            band = "" if pd.isna(point["half"]) else f" ({low:.3g} to {high:.3g})"
            row.append(f"{point['mean']:.4g}{band} at {point['x']:g}")
        rows.append(row)
    return make_rows(["line", "n at each point", "runs", f"first: {curves.y}", f"last: {curves.y}"], rows)


class Difference(NamedTuple):
    """How runs differ in one respect: in words, or in a frame with a row for each value that differs."""

    name: str
    told: str
    frame: pd.DataFrame = pd.DataFrame()

    @property
    def title(self) -> str:
        """Its name, and what is said of it."""
        return f"{self.name}: {self.told}" if self.told else self.name


@dataclass(frozen=True)
class Comparison:
    """Runs beside each other, in the order in which they were named: what differs, or `everything`.

    Up to `most` runs, each has a column; of more, values are counted. Of the configuration, all is looked at (`whole`),
    or what the stages read.
    """

    ledgers: tuple[Ledger, ...]
    everything: bool = False
    most: int = MOST_COLUMNS
    whole: bool = True

    @cached_property
    def labels(self) -> list[str]:
        """What each run is called in headings: its name, or a number where names are long."""
        names = [each.name for each in self.ledgers]
        short = max(map(len, names)) <= LONGEST_NAME
        return names if short else [f"run {number}" for number, _ in enumerate(names, 1)]

    @cached_property
    def nested(self) -> list[dict[str, Any]]:
        """Configuration of each run: whole, or what its stages read where that is all that is left."""
        return [(self.whole and read_config(each.folder)) or read_slices(each) for each in self.ledgers]

    @cached_property
    def flat(self) -> list[dict[str, str]]:
        """The same by dotted key."""
        return [flatten(each) if each else {} for each in self.nested]

    def differences(self) -> list[Difference]:
        """Return how the runs differ in everything, in the order in which it is told."""
        configuration, surroundings = self.configuration(), self.surroundings()
        names = dict.fromkeys(name for each in self.nested for name in list_headlines(each))
        return [
            Difference("Runs", "", self._list_runs()),
            Difference("Configuration", "" if len(configuration) else "no key differs", configuration),
            self._compare_metrics(),
            *(found for name in names if (found := self._compare_table(name))),
            *self._compare_files(),
            Difference(
                "Code, libraries, machines",
                format_count(len(surroundings), "difference") if len(surroundings) else "no difference",
                surroundings,
            ),
        ]

    def configuration(self) -> pd.DataFrame:
        """Return the keys that differ, of those that say what is computed."""
        if self.everything:
            return self._across("key", self.flat)
        folded = _fold_sections(self.flat)
        return self._across("key", folded, [*filter(is_incidental, self._keys(folded))])

    def surroundings(self) -> pd.DataFrame:
        """Return how code, libraries and machines differ."""
        return self._across("what", [flatten(read_surroundings(each)) for each in self.ledgers])

    def _list_runs(self) -> pd.DataFrame:
        names = [each.name for each in self.ledgers]
        return pd.DataFrame(
            {
                **({} if self.labels == names else {"column": self.labels}),
                "run": names,
                "status": [live_status(each) for each in self.ledgers],
                "started": [each.facts["started"] for each in self.ledgers],
                "wall_s": [each.seconds for each in self.ledgers],
            }
        )

    def _compare_metrics(self) -> Difference:
        found = [each.metrics for each in self.ledgers]
        columns: dict[str, list[Any]] = {}
        same = []
        for name in dict.fromkeys(name for each in found for name in each):
            shown = [show_metric(name, each[name]) if name in each else ("", None) for each in found]
            if len({repr(value) for _, value in shown}) > 1 or self.everything:
                columns[next(head for head, _ in shown if head)] = [value for _, value in shown]
            elif all(name in each for each in found):
                same.append(name)
        told = "" if columns else "none is declared, or none was kept"
        told = f"the same in all: {', '.join(same)}" if same else told
        return Difference("Metrics", told, pd.DataFrame({"run": self.labels, **columns} if columns else {}))

    def _compare_files(self) -> list[Difference]:
        """Return how the bytes of tables differ, and which are the same."""
        found = [list_tables(each) for each in self.ledgers]
        names = dict.fromkeys(name for each in found for name in each)
        same = [name for name in names if len({each.get(name, {}).get("sha256") for each in found}) == 1]
        told = [
            {name: f"{facts.get('rows', '?')} rows, {facts['sha256'][:8]}" for name, facts in each.items()}
            for each in found
        ]
        others = self._across("table", told, same)
        return [
            Difference("Tables that differ", ", ".join(others.iloc[:, 0]) if len(others) else "none", others),
            Difference("the same to the byte in all", ", ".join(same) or "no table"),
        ]

    def _compare_table(self, name: str) -> Difference | None:
        runs = dict(zip(self.labels, self.ledgers, strict=True))
        having = {label: each for label, each in runs.items() if name in list_tables(each)}
        if len(having) < 2:
            return None
        if len({list_tables(each)[name]["sha256"] for each in having.values()}) == 1:
            return Difference(name, "the same to the byte in all runs that have it")
        read = {label: found for label, each in having.items() if (found := read_whole_table(each, name))}
        if len(read) < 2:
            return Difference(name, "cannot be read in all runs but one")
        frames = {label: frame for label, (frame, _, _) in read.items()}
        if all(is_prose(each) for each in frames.values()):
            return Difference(name, "sentences, and the runs that have them", _compare_prose(frames))
        units = {key: unit for _, found, _ in read.values() for key, unit in found.items()}
        return Difference(name, *_compare_rows(frames, units))

    def _keys(self, flat: Sequence[Mapping[str, str]]) -> list[str]:
        return [*dict.fromkeys(key for each in flat for key in each)] if self.everything else list_differences(flat)

    def _across(self, head: str, flat: Sequence[Mapping[str, str]], hidden: Sequence[str] = ()) -> pd.DataFrame:
        """Return a column for each run, or each value with the number of runs where there are too many."""
        rows = [(key, [each.get(key, ABSENT) for each in flat]) for key in self._keys(flat) if key not in hidden]
        if 0 < len(self.ledgers) <= self.most:
            short = [[key, *(shorten(each, LONGEST_VALUE) for each in values)] for key, values in rows]
            return pd.DataFrame(short, columns=[head, *self.labels])
        counted = []
        for key, values in rows:
            counts = pd.Series(values).value_counts()
            told = [f"{shorten(str(value), LONGEST_VALUE)} ({count})" for value, count in counts.items()]
            counted.append([key, join_some(told, 8)])
        return pd.DataFrame(counted, columns=[head, "value (runs)"])


def _fold_sections(flat: Sequence[Mapping[str, str]], depth: int = 2) -> list[dict[str, str]]:
    """Return configurations in which what only some runs have, down to a depth, is one key, which says what it has."""
    folded = [dict(each) for each in (flat if depth == 1 else _fold_sections(flat, depth - 1))]
    found = [Counter(_begin(key, depth) for key in each if key.count(".") >= depth) for each in folded]
    having = Counter(name for each in found for name in each)
    partly = {name for name, count in having.items() if count < len(found)}
    for each, counts in zip(folded, found, strict=True):
        for key in [key for key in each if _begin(key, depth) in partly and key.count(".") >= depth]:
            del each[key]
        own = {name: count for name, count in counts.items() if name in partly}
        if depth == 1 and own:
            each["sections"] = ", ".join(f"{name} ({count})" for name, count in own.items())
        elif depth > 1:
            each.update({f"{name}.*": format_count(count, "key") for name, count in own.items()})
    return folded


def _begin(key: str, depth: int) -> str:
    return ".".join(key.split(".")[:depth])


def _choose_runs(outputs: str, names: Sequence[str]) -> tuple[Ledger, ...]:
    """Return the runs of these names, two or more; of a sweep, all jobs that are done."""
    ledgers = list_ledgers(outputs)
    known, sweeps = {each.name for each in ledgers}, {each.sweep for each in ledgers if each.sweep}
    chosen: dict[str, Ledger] = {}
    for name in names:
        bare = name.rstrip("/")
        if bare in sweeps and bare not in known:
            jobs = [each for each in ledgers if each.sweep == bare and each.status == "done"]
            if not jobs:
                raise ConfigError(f"sweep '{bare}' has no job that is done; see {review_line(outputs, 'sweep', bare)}")
        elif ledgers and bare != "latest" and not any(each.startswith(bare) for each in known):
            raise ConfigError(f"no run or sweep '{name}' in {outputs}; {suggest(bare, [*known, *sweeps, 'latest'])}")
        else:
            jobs = [find_run(outputs, bare)]
        chosen.update({each.name: each for each in sorted(jobs, key=lambda each: each.name)})
    if len(chosen) < 2:
        raise ConfigError(f"compare: expected two runs or more, or a sweep with as many done, got {', '.join(chosen)}")
    return tuple(chosen.values())


def _compare_prose(frames: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    sentences = [dict.fromkeys(map(str, frame.iloc[:, 0])) for frame in frames.values()]
    every = dict.fromkeys(sentence for each in sentences for sentence in each)
    rows = [[sentence, *("yes" if sentence in each else "-" for each in sentences)] for sentence in every]
    return pd.DataFrame([row for row in rows if "-" in row[1:]][:MOST_ROWS], columns=["sentence", *frames])


def _compare_rows(frames: Mapping[str, pd.DataFrame], units: Mapping[str, str]) -> tuple[str, pd.DataFrame]:
    columns = [name for name in next(iter(frames.values())).columns if all(name in each for each in frames.values())]
    key = _find_key([frame[columns] for frame in frames.values()])
    if key is None:
        counts = ", ".join(f"{len(frame)} in {label}" for label, frame in frames.items())
        return f"no columns name a row, so that rows cannot be compared ({counts})", pd.DataFrame()
    rest = [name for name in columns if name not in key]
    indexed: list[dict[tuple[Any, ...], tuple[Any, ...]]] = []
    for frame in frames.values():
        found = [tuple(None if each != each else each for each in row) for row in frame[[*key, *rest]].to_numpy(object)]
        indexed.append({row[: len(key)]: row[len(key) :] for row in found})
    common = [row for row in indexed[0] if all(row in each for each in indexed)]
    alone = len({row for each in indexed for row in each}) - len(common)
    rows = []
    for row in common:
        for place, name in enumerate(rest):
            values = [each[row][place] for each in indexed]
            if len({repr(value) for value in values}) > 1:
                change = [_format_change(*values)] if len(values) == 2 else []
                rows.append([*row, add_unit(name, units.get(name, "1")), *map(format_value, values), *change])
    heads = [*key, "column", *frames, *(["change"] if len(frames) == 2 else [])]
    if not common:
        return f"no row is in all runs; {format_count(alone, 'row is', 'rows are')} in some alone", pd.DataFrame()
    some = f"{format_count(len(common), 'row')} that all have"
    told = f"{format_count(len(rows), 'value differs', 'values differ')} in {some}"
    told += f", the first {MOST_ROWS} here" if len(rows) > MOST_ROWS else ""
    told += f"; {format_count(alone, 'row is', 'rows are')} in some runs alone" if alone else ""
    return told, pd.DataFrame(rows[:MOST_ROWS], columns=heads)


def _find_key(frames: Sequence[pd.DataFrame]) -> list[str] | None:
    """Return the first columns but numbers with fractions that together name each row once, in all frames."""
    if all(len(frame) <= 1 for frame in frames):
        return []
    key: list[str] = []
    for name in frames[0].columns:
        if any(pd.api.types.is_float_dtype(frame[name]) for frame in frames):
            continue
        key.append(name)
        if not any(frame.duplicated(key).any() for frame in frames):
            return key
    return None


def _format_change(before: Any, after: Any) -> str:
    if not all(isinstance(each, int | float) and not isinstance(each, bool) for each in (before, after)):
        return ""
    share = f" (x {after / before:.3g})" if before and after / before > 0.0 else ""  # in % it would be % of %
    return f"{after - before:+.3g}{share}"
