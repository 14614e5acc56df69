"""What a tracker is told of a run, a job or a sweep: its folder flows in, an `Entry` flows out.

All of it comes from the folder, so that what is sent while a run works, and what is sent years later, are the same.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from itertools import starmap
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from pipeline.config import Curve
from pipeline.errors import TableError
from pipeline.files import hash_file, hash_json
from pipeline.flat import flatten, is_incidental
from pipeline.ledger import FILE_NAME, Ledger, files_of
from pipeline.printing import format_counts, format_value, show_metric
from pipeline.report import PAGE_NAME
from pipeline.review.curves import average_repeats, split_series
from pipeline.review.kept import list_tables, read_config, read_workflow
from pipeline.runs import live_status
from pipeline.sweeps.launch import FACTS, FOLDER, list_launches
from pipeline.table import read_frame

FORM = 1
"""Of entries: what was sent in another form is sent again."""
LOOSE = ("config.yaml", FILE_NAME, "log.txt", PAGE_NAME)
"""Files of a run that its ledger does not list."""
OF_A_SWEEP = ("sweep.parquet", "sweep.html")
ENDED = ("done", "failed", "killed", "interrupted", "paused")


@dataclass(frozen=True)
class Point:
    """A value of a metric at a step, as of a time (ISO)."""

    name: str
    value: float
    step: int
    time: str


@dataclass(frozen=True)
class Dataset:
    """A table or a file that stages of a run read, by the SHA-256 of its bytes; rows where they are known."""

    name: str
    sha256: str
    read_by: str
    rows: int | None


@dataclass(frozen=True)
class Entry:
    """A run, a job of a sweep, or a sweep, as a tracker shows it.

    It is found again by its key; that of its sweep is `within`, empty for what is no job. The `stamp` says whether
    anything changed since it was sent. Files are SHA-256 by the path within the folder.
    """

    folder: Path
    name: str
    key: str
    within: str
    stamp: str
    status: str
    started: str
    ended: str | None
    params: dict[str, str] = field(default_factory=dict)
    tags: dict[str, str] = field(default_factory=dict)
    metrics: list[Point] = field(default_factory=list)
    series: list[Point] = field(default_factory=list)
    datasets: list[Dataset] = field(default_factory=list)
    files: dict[str, str] = field(default_factory=dict)
    note: str = ""


def is_sweep(folder: Path) -> bool:
    """Return whether a folder is that of a sweep, not of a run or job."""
    return folder.parent.name == "sweeps"


def list_jobs(sweep: Path) -> list[Path]:
    """Return the folders of the jobs of a sweep that have a ledger, by name."""
    return sorted(each.parent for each in sweep.glob(f"[!.]*/{FILE_NAME}"))


def key_of(folder: Path) -> str:
    """Return by what a run or sweep is found again: its name, and when and where it was first begun."""
    if is_sweep(folder):
        first = min((each.parent.name for each in (folder / FOLDER).glob(f"*/{FACTS}")), default="alone")
        return f"{folder.name} {first}"
    if is_sweep(folder.parent):
        return f"{key_of(folder.parent)} {folder.name}"
    facts = Ledger.look(folder)
    return " ".join([folder.name, *([facts.facts["started"], _host(facts)] if facts else [])])


def stamp_of(folder: Path, status: str) -> str:
    """Return a hash that changes with what is to be sent of a run or a job, without reading all of it."""
    loose = [folder / each for each in LOOSE] if status in ENDED else []
    sizes = [each.stat().st_size if each.is_file() else None for each in loose]
    return hash_json([FORM, status, hash_file(folder / FILE_NAME), sizes])


def read_entry(folder: Path, looks: bool = True) -> Entry | None:
    """Return what is told of a run or a job, None where its ledger cannot be read.

    Where one `looks`, a run that its ledger has running and that no process holds is told as killed.
    """
    ledger = Ledger.read(folder)
    if ledger is None:
        return None
    status = live_status(ledger) if looks else ledger.status
    config, facts = read_config(folder), ledger.facts
    is_job = is_sweep(folder.parent)
    ended = _find_end(ledger) if status in ENDED else None
    return Entry(
        folder,
        folder.name,
        key_of(folder),
        key_of(folder.parent) if is_job else "",
        stamp_of(folder, status),
        status,
        facts["started"],
        ended,
        {key: value for key, value in flatten(config).items() if key and not is_incidental(key)},
        {**_list_tags(ledger, config, status), **({"sweep": folder.parent.name} if is_job else {})},
        [*_list_metrics(ledger, ended)],
        [*_list_series(ledger, config)],
        _list_datasets(ledger),
        _list_files(ledger, status),
        _describe(ledger),
    )


def read_sweep(folder: Path, looks: bool = True) -> Entry | None:
    """Return what is told of a sweep beside its jobs, None where no job has begun."""
    ledgers = [found for each in list_jobs(folder) if (found := Ledger.look(each))]
    if not ledgers:
        return None
    launches = [*list_launches(folder)]
    planned = {str(each["job"]) for launch in launches for each in launch["jobs"]}
    counts = Counter(live_status(each) if looks else each.status for each in ledgers)
    counts["not begun"] = len(planned - {each.folder.name for each in ledgers})
    counts = +counts
    ended = all(each in ENDED for each in counts)
    status = "running" if not ended and not looks else "done" if {*counts} == {"done"} else "failed"
    newest = max(ledgers, key=lambda each: each.age)
    files = {each: hash_file(folder / each) for each in OF_A_SWEEP if (folder / each).is_file()}
    tags = {
        "status": status,
        "jobs": format_counts(dict(sorted(counts.items()))),
        "command": str(launches[-1]["command"]) if launches else "",
        "kind": "sweep",
        **_list_origin(newest),
    }
    return Entry(
        folder,
        folder.name,
        key_of(folder),
        "",
        hash_json([FORM, status, tags, files]),
        status,
        min(each.facts["started"] for each in ledgers),
        max((each.facts["ended"] or "" for each in ledgers), default="") or None if status != "running" else None,
        tags={key: value for key, value in tags.items() if value},
        files=files,
    )


def _list_tags(ledger: Ledger, config: dict[str, Any], status: str) -> dict[str, str]:
    facts = ledger.facts
    error = facts.get("error") or {}
    words = {name: each["value"] for name, each in ledger.metrics.items() if isinstance(each["value"], str)}
    tags = {
        "status": status,
        "command": facts["command"],
        "kind": "job" if is_sweep(ledger.folder.parent) else "run",
        "workflow": read_workflow(config, "name", str),
        "identity": facts["identity"][:16],
        "error": f"{error['stage']}: {error['message']}" if error else "",
        **_list_origin(ledger),
        **words,
    }
    return {key: value for key, value in tags.items() if value}


def _list_origin(ledger: Ledger) -> dict[str, str]:
    git = ledger.facts.get("git") or {}
    origin = {"commit": str(git.get("commit", "")), "dirty": str(not git.get("clean")).lower() if git else "unknown"}
    return {**origin, "host": _host(ledger)}


def _host(ledger: Ledger) -> str:
    return str((ledger.facts.get("machine") or {}).get("host", ""))


def _find_end(ledger: Ledger) -> str:
    """Return when a run ended; of one that could not note it, when its last file was written."""
    began = datetime.fromisoformat(ledger.facts["started"])
    return ledger.facts["ended"] or (began + timedelta(seconds=ledger.seconds)).isoformat(timespec="seconds")


def _list_metrics(ledger: Ledger, ended: str | None) -> Iterator[Point]:
    """Yield the numbers that tell a run, and what it took, once it has ended."""
    facts = ledger.facts
    if ended is None:
        return
    found = {name: each["value"] for name, each in ledger.metrics.items()}
    found |= {"wall_s": facts.get("seconds"), "peak_memory_mb": facts.get("peak_memory_mb")}
    for name, value in found.items():
        if isinstance(value, int | float) and math.isfinite(value):
            yield Point(name, float(value), 0, ended)


def _list_series(ledger: Ledger, config: dict[str, Any]) -> Iterator[Point]:
    """Yield the points of the curves that the workflow declares, means over repeats: a step is a value of x.

    Where values of x are no whole numbers, steps count them.
    """
    made = {name: record for record in ledger.records.values() for name in record["tables"] if record.get("ended")}
    for name, values in read_workflow(config, "curves", dict).items():
        try:
            curve = Curve.model_validate(values)
            if curve.table not in made:
                continue
            frame = read_frame(ledger.folder / "tables" / f"{curve.table}.parquet")  # as kept, as metrics are
            series = [*split_series(average_repeats(frame, curve), curve)]
        except (ValidationError, TableError, KeyError, TypeError, ValueError):
            continue
        for told, points in series:
            label = told.removeprefix(f"{curve.by[0]} ") if len(curve.by) == 1 else told
            whole = all(float(x).is_integer() for x in points["x"])
            for number, (x, mean) in enumerate(zip(points["x"], points["mean"], strict=True)):
                if math.isfinite(mean):
                    step = int(x) if whole else number
                    yield Point("/".join(filter(None, (name, label))), float(mean), step, made[curve.table]["ended"])


def _list_datasets(ledger: Ledger) -> list[Dataset]:
    """Return the tables that stages read, and the files that people brought for them."""
    tables = list_tables(ledger)
    readers: dict[tuple[str, str], list[str]] = {}
    for stage, record in ledger.records.items():
        for name, digest in record["inputs"].items():
            readers.setdefault((name, digest), []).append(stage)
    return [
        Dataset(name, digest, ", ".join(stages), tables.get(name, {}).get("rows"))
        for (name, digest), stages in readers.items()
    ]


def _list_files(ledger: Ledger, status: str) -> dict[str, str]:
    """Return the files to send: those that finished stages left, and at the end those that belong to no stage."""
    done = [record for record in ledger.records.values() if record["status"] == "done"]
    files = {file: facts["sha256"] for record in done for file, facts in files_of(record).items()}
    loose = LOOSE if status in ENDED else ("config.yaml",)
    return files | {each: hash_file(ledger.folder / each) for each in loose if (ledger.folder / each).is_file()}


def _describe(ledger: Ledger) -> str:
    """Return in Markdown how a run is told at a glance: its metrics with units, the reason of a failure."""
    error = ledger.facts.get("error")
    lines = [f"**{error['stage']}**: {error['message']}"] if error else []
    lines += [f"{head}: {format_value(value)}" for head, value in starmap(show_metric, ledger.metrics.items())]
    return "  \n".join(lines)
