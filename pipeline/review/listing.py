"""All runs and sweeps of an outputs folder, a line each: the folders flow in, text flows out."""

import argparse
from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import starmap
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console

from pipeline.command import command_line, review_line
from pipeline.errors import ConfigError, suggest
from pipeline.flat import flatten, walk
from pipeline.ledger import Ledger
from pipeline.printing import add_unit, format_count, print_frame, show_percent
from pipeline.review.kept import read_slices
from pipeline.review.selection import keep_rows, read_condition, sort_rows
from pipeline.runs import describe_status, list_folders, list_within, live_status, runs_folder, sweeps_folder
from pipeline.sweeps.launch import list_launches
from pipeline.terminal import say

COLUMNS = ["run", "status", "started", "wall_s", "finished", "command"]
WORST_FIRST = ("running", "failed", "killed", "paused", "interrupted", "unreadable", "no ledger", "not begun", "done")
"""Of its jobs' states, the one that a sweep is said to have."""


def review(options: argparse.Namespace, console: Console) -> None:
    """Print one line per run, and per sweep or each of its jobs; raise `ConfigError` for a key that no run has."""
    folder = runs_folder(options.outputs)
    if not list_folders(options.outputs):
        say(f"no runs in {folder}; make one with: {command_line([])}", console)
        return
    conditions = [read_condition(each) for each in options.where]
    keys = [each.key for each in conditions] + ([options.sort.removeprefix("-")] if options.sort else [])
    frame = _list_everything(options.outputs, options.jobs, list(dict.fromkeys(keys)))
    frame = sort_rows(keep_rows(frame, conditions), options.sort)
    found = [each for ledgers in frame.pop("found") for each in ledgers]
    units = {key: "%" for key in keys if any(each.metrics.get(key, {}).get("percent") for each in found)}
    shown = show_percent(frame, units).rename(columns=lambda name: add_unit(name, units.get(name, "")))
    print_frame(f"Runs in {folder.parent}", shown, console, options.rows, "--rows")
    if not options.jobs and frame["run"].str.endswith("/").any():
        say(f"a sweep's jobs: --jobs, or {review_line(options.outputs, 'sweep', 'NAME')}", console)


def _list_everything(outputs: str, with_jobs: bool, keys: Sequence[str]) -> pd.DataFrame:
    """Return a row for each run and each sweep or (`with_jobs`) job, newest first, with more keys and its ledgers."""
    alone = list_folders(outputs) if with_jobs else list_within(runs_folder(outputs))
    sweeps = [] if with_jobs else list_within(sweeps_folder(outputs))
    rows = [_describe(each) for each in alone]
    rows += [_summarise(each, jobs) for each in sweeps if (jobs := list_within(each))]
    rows.sort(key=lambda row: row["age"], reverse=True)
    frame = pd.DataFrame(rows, columns=[*COLUMNS, "found"])
    frame["wall_s"] = frame["wall_s"].astype(float)
    for key in [each for each in keys if each not in COLUMNS]:
        values = [_look_up(found, key) for found in frame["found"]]
        if all(value is None for value in values):
            offered = _suggest(key, [ledger for found in frame["found"] for ledger in found])
            raise ConfigError(f"no column, metric or configuration key '{key}' in any run; {offered}")
        frame.insert(len(frame.columns) - 2, key, pd.Series(values, dtype=object, index=frame.index))
    return frame


def _describe(folder: Path) -> dict[str, Any]:
    ledger, name = Ledger.look(folder), Ledger(folder).name
    if ledger is None:
        return {"run": name, "status": describe_status(folder, None), "age": (-1, name), "found": []}
    done = sum(ledger.finished(each) is not None for each in ledger.records)
    return {
        "run": name,
        "status": live_status(ledger),
        "started": ledger.facts["started"],
        "wall_s": ledger.seconds,
        "finished": format_count(done, "stage"),
        "command": ledger.facts["command"],
        "age": ledger.age,
        "found": [ledger],
    }


def _summarise(sweep: Path, jobs: Sequence[Path]) -> dict[str, Any]:
    looked = {each: Ledger.look(each) for each in jobs}
    counts = Counter(starmap(describe_status, looked.items()))
    planned = {each["job"] for launch in list_launches(sweep) for each in launch["jobs"]}
    counts["not begun"] += len(planned - {each.name for each in jobs})
    states = [each for each in WORST_FIRST if counts[each]]
    ledgers = [each for each in looked.values() if each]
    others = "".join(f", {counts[each]} {each}" for each in states if each != "done")
    return {
        "run": f"{sweep.name}/",
        "status": states[0],
        "started": min((each.facts["started"] for each in ledgers), default=None),
        "wall_s": sum(each.seconds for each in ledgers) if ledgers else None,
        "finished": f"{counts['done']} of {format_count(counts.total(), 'job')}{others}",
        "age": max((each.age for each in ledgers), default=(-1, sweep.name)),
        "found": ledgers,
    }


def _look_up(ledgers: Iterable[Ledger], key: str) -> Any:
    """Return a metric or a configuration key of a run; of a sweep, only what all its jobs agree in."""
    values = {str(value): value for each in ledgers if (value := _look_up_one(each, key)) is not None}
    return next(iter(values.values())) if len(values) == 1 else None


def _look_up_one(ledger: Ledger, key: str) -> Any:
    if key in ledger.metrics:
        return ledger.metrics[key]["value"]
    named = (value for path, value in walk(read_slices(ledger)) if path == key and value is not None)
    return next(named, None)


def _suggest(key: str, ledgers: Sequence[Ledger]) -> str:
    named = [*COLUMNS, *{name for each in ledgers for name in each.metrics}]
    paths = flatten({name: section for each in ledgers for name, section in read_slices(each).items()})
    offered = suggest(key, [*named, *paths])
    return f"{suggest(key, named)}, or a configuration key" if offered.startswith("choose") else offered
