"""report.html and the terminal's final tables: what a run found, readable by someone who was not there.

A run's ledger, tables and figures flow in; one self-contained page flows out, with no request to any other place.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from importlib.resources import files as package_files
from pathlib import Path
from typing import Any

import jinja2
import pandas as pd
from omegaconf import OmegaConf
from rich.console import Console

from pipeline.config import Study
from pipeline.files import write_text
from pipeline.ledger import Ledger
from pipeline.printing import ROWS_SHOWN_WHOLE, format_value, is_prose, print_frame
from pipeline.stage import Stage
from pipeline.table import Table, read_frame

ROWS_OF_A_LONG_TABLE = 6


def write_report(ledger: Ledger, study: Study, stages: Sequence[Stage]) -> Path:
    """Write report.html into a run's folder.

    Parameters
    ----------
    ledger : Ledger
        Of the run.
    study : Study
        Its configuration.
    stages : sequence of Stage
        All stages of the workflow; those that the run lacks are left out.

    Returns
    -------
    Path
        The page.
    """
    done = [each for each in stages if ledger.finished(each.name)]
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    template = environment.from_string(package_files("pipeline").joinpath("report.html.j2").read_text(encoding="utf-8"))
    headline = headline_tables(study, done)
    telling = [each.name for each in done if any(table in headline for table in each.writes)]
    page = template.render(
        run=ledger.name,
        facts=ledger.facts,
        workflow=study.settings.workflow.name,
        headline=[_table(ledger, table) for table in headline],
        headline_figures=[figure for name in telling for figure in _figures(ledger, name)],
        stages=[{**_stage(ledger, each), "told_above": each.name in telling} for each in done],
        config=OmegaConf.to_yaml(OmegaConf.create(study.values)),
    )
    path = ledger.folder / "report.html"
    write_text(path, page)
    return path


def is_whole_page(path: Path) -> bool:
    """Tell whether a report is there to its last line."""
    return path.is_file() and path.read_bytes().rstrip().endswith(b"</html>")


def headline_tables(study: Study, stages: Sequence[Stage]) -> list[Table]:
    """Return the contracts of the tables that the workflow wants seen first, as far as the stages write them."""
    by_name = {table.name: table for each in stages for table in each.writes}
    return [by_name[name] for name in study.settings.workflow.headline if name in by_name]


def print_headline(ledger: Ledger, study: Study, stages: Sequence[Stage], console: Console) -> None:
    """Print the headline tables of a run."""
    done = [each for each in stages if ledger.finished(each.name)]
    for table in headline_tables(study, done):
        frame = read_frame(ledger.folder / "tables" / f"{table.name}.parquet")
        print_frame(table.title, frame[list(table.brief or table.columns)], console)


def _stage(ledger: Ledger, stage: Stage) -> dict[str, Any]:
    record = ledger.records[stage.name]
    documents = [
        {
            "name": Path(file).name,
            "text": (ledger.folder / file).read_text(encoding="utf-8"),
        }
        for file, facts in record["files"].items()
        if facts["kind"] == "document"
    ]
    return {
        "name": stage.name,
        "summary": stage.summary,
        "record": record,
        "reused": record["origin"] != ledger.name,
        "figures": _figures(ledger, stage.name),
        "documents": documents,
        "tables": [_table(ledger, table) for table in stage.writes],
    }


def _figures(ledger: Ledger, stage: str) -> list[dict[str, str]]:
    """Return a stage's figures; one that was not kept as PNG has no data."""
    files = ledger.records[stage]["files"]
    captions = {Path(file).stem: str(facts["caption"]) for file, facts in files.items() if facts["kind"] == "figure"}
    return [
        {
            "name": name,
            "caption": caption,
            "data": _encode(ledger.folder / shown) if (shown := f"figures/{name}.png") in files else "",
            "files": ", ".join(each for each in files if Path(each).stem == name),
        }
        for name, caption in captions.items()
    ]


def _table(ledger: Ledger, table: Table) -> dict[str, Any]:
    frame = read_frame(ledger.folder / "tables" / f"{table.name}.parquet")
    short = len(frame) <= ROWS_SHOWN_WHOLE
    shown = frame if short else frame.head(ROWS_OF_A_LONG_TABLE)
    return {
        "name": table.name,
        "title": table.title,
        "rows": len(frame),
        "short": short,
        "prose": is_prose(frame),
        "columns": [each for each in table.describe() if each[0] in frame.columns],
        "numeric": [bool(pd.api.types.is_numeric_dtype(frame[name])) for name in frame.columns],
        "cells": [[format_value(value) for value in row] for row in shown.itertuples(index=False)],
    }


def _encode(path: Path) -> str:
    return base64.b64encode(path.read_bytes()).decode()
