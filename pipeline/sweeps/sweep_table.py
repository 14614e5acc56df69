"""The table of a sweep: a row for each job, from the ledgers in the jobs' folders and what the launches wrote down.

A sweep's folder flows in, a frame and ``sweep.parquet`` flow out. The folders are the record: the table can be made
anew from them at any time, on any machine.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow
import pyarrow.parquet

from pipeline.checkout import describe_commit
from pipeline.errors import ConfigError
from pipeline.files import write_atomically
from pipeline.ledger import Ledger
from pipeline.printing import SHOWN
from pipeline.runs import describe_status, list_within
from pipeline.sweeps.launch import is_meaningful, list_launches

FILE_NAME = "sweep.parquet"
UNITS = {"wall_s": {"unit": "s"}, "peak_memory_mb": {"unit": "MB"}}
LAST = ("wall_s", "peak_memory_mb", "stage", "error", "commit", "started", "ended")


def collect_sweep(sweep: Path) -> tuple[pd.DataFrame, dict[str, dict[str, str]]]:
    """Return a row for each job of a sweep, and for columns of numbers unit and title, as ``sweep.parquet`` has them.

    The columns are ``job``; the keys that a job overrides, as text; ``status``; the metrics; ``wall_s``,
    ``peak_memory_mb``, ``stage`` and ``error`` (where and why it failed), ``commit``, ``started`` and ``ended``.
    """
    if not sweep.is_dir():
        raise ConfigError(f"no sweep in {sweep}; expected a folder in outputs/sweeps")
    overrides = {str(job["job"]): job["overrides"] for launch in list_launches(sweep) for job in launch["jobs"]}
    found = {each.name for each in list_within(sweep)}
    rows: list[dict[str, Any]] = []
    axes: dict[str, None] = {}
    metrics: dict[str, dict[str, str]] = {}
    for job in sorted({*overrides, *found}, key=_in_order):
        ledger = Ledger.read(sweep / job) if job in found else None  # one at a time, as they may be thousands
        values = split_overrides(overrides.get(job) or job.split(","))
        axes.update(dict.fromkeys(values))
        facts, measured = (ledger.facts, ledger.metrics) if ledger else ({}, {})
        metrics.update({name: _describe_metric(each) for name, each in measured.items()})
        error = facts.get("error") or {}
        absent = "not begun" if job in overrides else "no ledger"
        rows.append(
            {
                **values,
                **{name: each["value"] for name, each in measured.items()},
                "job": job,
                "status": describe_status(sweep / job, ledger, absent) if job in found else "not begun",
                "wall_s": ledger.seconds if ledger else None,
                "peak_memory_mb": facts.get("peak_memory_mb"),
                "stage": error.get("stage"),
                "error": error.get("message"),
                "commit": describe_commit(facts["git"]) if facts.get("git") else None,
                "started": facts.get("started"),
                "ended": facts.get("ended"),
            }
        )
    order = ["job", *(each for each in axes if each not in metrics), "status", *metrics, *LAST]
    frame = pd.DataFrame(rows, columns=list(dict.fromkeys(order)))
    numbers = [name for name in (*metrics, *UNITS) if not any(isinstance(each, str) for each in frame[name])]
    frame[numbers] = frame[numbers].astype(float)
    return frame, {**UNITS, **metrics}


def _describe_metric(metric: Mapping[str, Any]) -> dict[str, str]:
    shown = {"title": metric.get("title"), SHOWN: "%" if metric.get("percent") else None, "low": metric.get("low")}
    return {"unit": str(metric["unit"]), **{key: str(value) for key, value in shown.items() if value is not None}}


def write_frame(sweep: Path, frame: pd.DataFrame, described: Mapping[str, dict[str, str]]) -> Path:
    """Write what `collect_sweep` returned as ``sweep.parquet``; return its path."""
    fields = [
        each.with_metadata(described[each.name]) if each.name in described else each
        for each in pyarrow.Schema.from_pandas(frame, preserve_index=False)
    ]
    contents = pyarrow.Table.from_pandas(frame, schema=pyarrow.schema(fields), preserve_index=False)
    path = sweep / FILE_NAME
    write_atomically(path, lambda temporary: pyarrow.parquet.write_table(contents, temporary))
    return path


def split_overrides(overrides: Sequence[str]) -> dict[str, str]:
    """Return the telling overrides of a job by key, without the marks by which a key is added."""
    pairs = (each.partition("=") for each in overrides if is_meaningful(each))
    return {key.lstrip("+"): value for key, sign, value in pairs if sign}


def _in_order(job: str) -> list[tuple[bool, float, str]]:
    """Return a sort key by which numbers in a name come in the order of their size."""
    return [(each.isdigit(), float(each) if each.isdigit() else 0.0, each) for each in re.split(r"(\d+)", job)]
