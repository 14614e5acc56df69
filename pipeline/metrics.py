"""The few numbers that tell a run at a glance: read from its tables, kept in its ledger, compared in a sweep."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import pandas as pd

from pipeline.config import Study
from pipeline.ledger import Ledger
from pipeline.stage import Stage
from pipeline.table import read_frame


def read_metrics(ledger: Ledger, study: Study, stages: Sequence[Stage]) -> dict[str, dict[str, Any]]:
    """Return ``value`` and ``unit`` of each metric that the workflow declares, as far as the run has their tables.

    A value is None where no row is meant, or none has a value.
    """
    contracts = {table.name: table for each in stages if ledger.finished(each.name) for table in each.writes}
    found = {}
    for name, metric in study.settings.workflow.metrics.items():
        if metric.table not in contracts:
            continue
        frame = read_frame(ledger.folder / "tables" / f"{metric.table}.parquet")
        for wanted, rules in ((True, metric.where), (False, metric.but)):
            for column, value in rules.items():
                frame = frame[frame[column].isin(value if isinstance(value, list) else [value]) == wanted]
        found[name] = {
            "value": _reduce(frame[metric.column].dropna(), metric.by),
            "unit": contracts[metric.table].columns[metric.column].metadata["unit"],
        }
    return found


def _reduce(values: pd.Series, by: str) -> float | str | None:
    """Return one value of many, None where there is none that JSON can hold."""
    if values.empty:
        return None
    if by in ("first", "last") or not pd.api.types.is_numeric_dtype(values):
        found = values.iloc[-1 if by == "last" else 0]
    else:
        found = values.agg(by)
    if isinstance(found, str):
        return found
    return float(found) if math.isfinite(found) else None
