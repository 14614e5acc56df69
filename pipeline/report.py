"""report.html and the terminal's final tables: what a run found, readable by someone who was not there.

A run's ledger, tables and figures flow in; one self-contained page flows out, with no request to any other place.
"""

from __future__ import annotations

import base64
import json
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf
from rich.console import Console

from pipeline.config import Study
from pipeline.failures import read_traceback, tell_reason
from pipeline.files import write_text
from pipeline.flat import flatten, show
from pipeline.ledger import Ledger
from pipeline.page import make_grid, make_rows, render
from pipeline.printing import ROWS_SHOWN_WHOLE, add_unit, format_value, is_prose, print_frame
from pipeline.stage import Stage
from pipeline.table import Table, read_frame

log = logging.getLogger("pamid")

PAGE_NAME = "report.html"
VERDICT = "verdict.json"
"""Document that is told before all tables."""
ROWS_OF_A_LONG_TABLE = 6


def write_report(ledger: Ledger, study: Study, stages: Sequence[Stage], status: str | None = None) -> Path:
    """Write report.html into a run's folder, also of a run that did not get to its end.

    Parameters
    ----------
    ledger : Ledger
        Of the run.
    study : Study
        Its configuration.
    stages : sequence of Stage
        All stages of the workflow; of a run that failed, those up to the one that did are told.
    status : str, optional
        How the run ended, where its ledger does not say so yet.

    Returns
    -------
    Path
        The page.
    """
    status = status or ledger.status
    reached = _list_reached(ledger, stages)
    done = [each for each in reached if ledger.finished(each.name)]
    headline = headline_tables(study, done)
    telling = [each.name for each in done if any(table in headline for table in each.writes)]
    told = [{**_stage(ledger, each), "told_above": each.name in telling} for each in done]
    documents = [document for each in told for document in each["documents"]]
    page = render(
        "report.html.j2",
        run=ledger.name,
        facts=ledger.facts,
        status=status,
        reason=tell_reason(ledger, status) if ledger.facts["error"] else "",
        traceback=read_traceback(ledger.folder) if status == "failed" else "",
        workflow=study.settings.workflow.name,
        plan=_make_plan(ledger, stages, reached),
        metrics=_list_metrics(ledger),
        verdict=next((_outline(each["text"]) for each in documents if each["name"] == VERDICT), None),
        headline=[_table(ledger, table) for table in headline],
        headline_figures=[figure for name in telling for figure in _figures(ledger, name)],
        stages=told,
        config=OmegaConf.to_yaml(OmegaConf.create(study.values)),
    )
    path = ledger.folder / PAGE_NAME
    write_text(path, page)
    return path


def try_report(ledger: Ledger, study: Study, stages: Sequence[Stage]) -> Path | None:
    """Write the report of a run that did not get to its end, or note in its log why there is none."""
    try:
        return write_report(ledger, study, stages)
    except Exception:
        log.warning("no report could be written", exc_info=True)
        return None


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


def _list_reached(ledger: Ledger, stages: Sequence[Stage]) -> list[Stage]:
    """Return the stages up to the one that stopped the run: what is kept of later ones is from an earlier attempt."""
    names = [each.name for each in stages]
    error = ledger.facts["error"] or {}
    return list(stages[: names.index(error["stage"]) + 1] if error.get("stage") in names else stages)


def _make_plan(ledger: Ledger, stages: Sequence[Stage], reached: Sequence[Stage]) -> dict[str, Any]:
    rows = []
    for each in stages:
        record = ledger.records.get(each.name) if each in reached else None
        if record is None:
            rows.append([each.name, "not reached" if ledger.facts["error"] else "left out", None, "-", "-"])
            continue
        reused = record["origin"] != ledger.name
        word = ("fresh" if reused else "ran") if record["status"] == "done" else record["status"]
        reason = f"made in {record['origin']}" if reused else record["reason"]
        tables = ", ".join(f"{name} ({facts['rows']})" for name, facts in record["tables"].items())
        rows.append([each.name, word, None if reused else record.get("seconds"), reason, tables or "-"])
    return make_rows(["stage", "what was done", "seconds", "because", "tables (rows)"], rows)


def _list_metrics(ledger: Ledger) -> list[tuple[str, str]]:
    found = ledger.facts.get("metrics") or {}
    return [(add_unit(name, each["unit"]), format_value(each["value"])) for name, each in found.items()]


def _outline(text: str) -> dict[str, Any]:
    """Return a JSON document as values by dotted key, and a grid for each of its lists of sections."""
    values = json.loads(text)
    lists = {key: each for key, each in values.items() if _is_grid(each)} if isinstance(values, Mapping) else {}
    grids = {}
    for key, rows in lists.items():
        heads = list(dict.fromkeys(name for row in rows for name in row))
        cells = [[each if _is_plain(each := row.get(name)) else _list_lines(each) for name in heads] for row in rows]
        grids[key] = make_rows(heads, cells)
    rest = {key: each for key, each in values.items() if key not in lists} if lists else values
    return {"values": flatten(rest, tell=_tell) if rest else {}, "lists": grids}


def _list_lines(section: Any) -> str:
    """Return the values of a section, one a line."""
    return "\n".join(f"{key}: {text}" if key else text for key, text in flatten(section, tell=_tell).items())


def _tell(value: Any) -> str:
    """Return a value as a page shows it; a list of plain values is one."""
    if isinstance(value, list) and all(map(_is_plain, value)):
        return ", ".join(map(format_value, value)) or "-"
    return format_value(value) if _is_plain(value) else show(value)


def _is_grid(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(each, Mapping) for each in value)


def _is_plain(value: Any) -> bool:
    return value is None or isinstance(value, int | float | str)


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
    described = [each for each in table.describe() if each[0] in frame.columns]
    units = {name: unit for name, unit, _ in described}
    meanings = {name: meaning for name, _, meaning in described}
    return {
        **make_grid(shown, units, meanings),
        "name": table.name,
        "title": table.title,
        "rows": len(frame),
        "short": short,
        "prose": is_prose(frame),
    }


def _encode(path: Path) -> str:
    return base64.b64encode(path.read_bytes()).decode()
