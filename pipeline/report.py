"""report.html and the terminal's final tables: what a run found, readable by someone who was not there.

A run's ledger, tables and figures flow in; one self-contained page flows out, with no request to any other place.
"""

import json
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from omegaconf import OmegaConf
from rich.console import Console

from pipeline.checkout import describe_commit
from pipeline.config import Study
from pipeline.failures import describe_reason, read_traceback
from pipeline.flat import flatten, show
from pipeline.ledger import Ledger
from pipeline.page import (
    Block,
    Picture,
    Section,
    list_sentences,
    make_details,
    make_grid,
    make_rows,
    show_traceback,
    write_page,
)
from pipeline.printing import ROWS_SHOWN_WHOLE, add_unit, format_value, is_prose, print_frame
from pipeline.stage import Stage
from pipeline.table import Table, read_frame

log = logging.getLogger("pamid")

PAGE_NAME = "report.html"
VERDICT = "verdict.json"
"""Document that is told before all tables."""
ROWS_OF_A_LONG_TABLE = 6
ROWS_SHOWN_AT_ONCE = 8
"""Of a list in the verdict, up to which it is open."""


def write_report(ledger: Ledger, study: Study, stages: Sequence[Stage], status: str | None = None) -> Path:
    """Write report.html into a run's folder, also of a run that did not get to its end; return its path.

    Of all stages of the workflow, those up to the one that failed, if one did, are told. `status` says how the run
    ended, where its ledger does not say so yet.
    """
    status = status or ledger.status
    names, last = [each.name for each in stages], (ledger.facts["error"] or {}).get("stage")
    reached = stages[: names.index(last) + 1] if last in names else stages  # what is kept of later ones is older
    done = [each for each in reached if ledger.finished(each.name)]
    headline = headline_tables(study, done)
    shown_first = [each.name for each in done if any(table in headline for table in each.writes)]
    workflow = study.settings.workflow.name
    path = ledger.folder / PAGE_NAME
    write_page(
        path,
        title=f"{workflow} {ledger.name}",
        heading=workflow.replace("_", " ").capitalize(),
        lead=f"Run {ledger.name}",
        status=status,
        opening=[("command", ledger.facts["command"]), ("facts", _list_facts(ledger)), *_show_failure(ledger, status)],
        sections=[
            Section("Result", _show_result(ledger, headline, shown_first)),
            Section("Verdict", [block for each in done for block in _show_verdict(ledger, each)]),
            Section("Plan", [("grid", _make_plan(ledger, stages, reached))]),
            *(Section(each.name, _show_stage(ledger, each, each.name in shown_first)) for each in done),
            Section("Configuration", [("text", OmegaConf.to_yaml(OmegaConf.create(study.values)))]),
        ],
    )
    return path


def try_report(ledger: Ledger, study: Study, stages: Sequence[Stage]) -> Path | None:
    """Write the report of a run that did not get to its end, or note in its log why there is none."""
    try:
        return write_report(ledger, study, stages)
    except Exception:
        log.warning("no report could be written", exc_info=True)
        return None


def is_whole_page(path: Path) -> bool:
    """Return whether a report is there to its last line."""
    return path.is_file() and path.read_bytes().rstrip().endswith(b"</html>")


def headline_tables(study: Study, stages: Sequence[Stage]) -> list[Table]:
    """Return the contracts of the tables that the workflow wants seen first, as far as the stages write them."""
    by_name = {table.name: table for each in stages for table in each.writes}
    return [by_name[name] for name in study.settings.workflow.headline if name in by_name]


def print_headline(ledger: Ledger, study: Study, stages: Sequence[Stage], console: Console) -> None:
    """Print the headline tables of a run."""
    done = [each for each in stages if ledger.finished(each.name)]
    for table in headline_tables(study, done):
        frame = _read(ledger, table)
        print_frame(table.title, frame[list(table.brief or frame.columns)], console)


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


def _list_facts(ledger: Ledger) -> list[tuple[str, str]]:
    machine, git = ledger.facts["machine"], ledger.facts["git"]
    metrics = ledger.facts.get("metrics") or {}
    return [
        ("Started", ledger.facts["started"]),
        ("Machine", f"{machine['system']}, {machine['cores']} cores, Python {machine['python']}"),
        *([("Code", describe_commit(git))] if git else []),
        *((add_unit(name, each["unit"]), format_value(each["value"])) for name, each in metrics.items()),
    ]


def _show_failure(ledger: Ledger, status: str) -> list[Block]:
    if not ledger.facts["error"]:
        return []
    kept = "What was done before is kept; the command above goes on from there."
    traceback = read_traceback(ledger.folder) if status == "failed" else ""
    blocks: list[Block] = [("status", (status, describe_reason(ledger, status))), ("note", kept)]
    return [("failure", blocks + show_traceback("traceback", traceback, is_open=True))]


def _show_result(ledger: Ledger, headline: Sequence[Table], shown_first: Sequence[str]) -> list[Block]:
    """Return the sentences that the workflow wants seen first, then the figures, then the other tables."""
    frames = [(table, _read(ledger, table)) for table in headline]
    prose: list[Block] = [("prose", list_sentences(frame)) for _, frame in frames if is_prose(frame)]
    pictures: list[Block] = [("pictures", [each]) for name in shown_first for each in _list_pictures(ledger, name)]
    others: list[Block] = []
    for table, frame in frames:
        if not is_prose(frame) and len(frame):
            others += [("heading", table.title), *_show_rows(table, frame)]
    return prose + pictures + others


def _show_verdict(ledger: Ledger, stage: Stage) -> list[Block]:
    """Return a stage's verdict as values by dotted key, and a grid for each of its lists of sections."""
    if VERDICT not in ledger.records[stage.name]["files"]:
        return []
    values = json.loads((ledger.folder / VERDICT).read_text(encoding="utf-8"))
    lists = {
        key: each
        for key, each in values.items()
        if isinstance(each, list) and each and all(isinstance(row, Mapping) for row in each)
    }
    rest = {key: each for key, each in values.items() if key not in lists}
    blocks: list[Block] = [("facts", [*flatten(rest, form=_format).items()] if rest else [])]
    for key, rows in lists.items():
        heads = list(dict.fromkeys(name for row in rows for name in row))
        cells = [[each if _is_plain(each := row.get(name)) else _list_lines(each) for name in heads] for row in rows]
        grid: Block = ("grid", make_rows(heads, cells))
        blocks.append(make_details(f"{key} ({len(rows)})", [grid], len(rows) <= ROWS_SHOWN_AT_ONCE))
    return blocks


def _list_lines(section: Any) -> str:
    """Return the values of a section, one a line."""
    return "\n".join(f"{key}: {text}" if key else text for key, text in flatten(section, form=_format).items())


def _format(value: Any) -> str:
    """Return a value as a page shows it; a list of plain values is one."""
    if isinstance(value, list) and all(map(_is_plain, value)):
        return ", ".join(map(format_value, value)) or "-"
    return format_value(value) if _is_plain(value) else show(value)


def _is_plain(value: Any) -> bool:
    return value is None or isinstance(value, int | float | str)


def _show_stage(ledger: Ledger, stage: Stage, shown_above: bool) -> list[Block]:
    record = ledger.records[stage.name]
    made = f"Made in {record.get('seconds')} s: {record['reason']}."
    if record["origin"] != ledger.name:
        made = f"Made in run {record['origin']} and reused."
    blocks: list[Block] = [("note", stage.summary), ("note", made)]
    pictures = _list_pictures(ledger, stage.name)
    blocks += [("note", f"{each.caption}: see the result.") for each in pictures if shown_above]
    blocks += [("pictures", [each]) for each in pictures if not shown_above]
    for table in stage.writes:
        frame = _read(ledger, table)
        part = "" if len(frame) <= ROWS_SHOWN_WHOLE else f", the first {ROWS_OF_A_LONG_TABLE} here"
        note = f"{table.title}. {len(frame)} rows{part}; tables/{table.name}.parquet"
        blocks += [("heading", table.name), ("note", note), *_show_rows(table, frame)]
    for file, facts in record["files"].items():
        if facts["kind"] == "document":
            text = (ledger.folder / file).read_text(encoding="utf-8")
            blocks.append(make_details(Path(file).name, [("text", text)]))
    return blocks


def _list_pictures(ledger: Ledger, stage: str) -> list[Picture]:
    files = ledger.records[stage]["files"]
    captions = {Path(file).stem: str(facts["caption"]) for file, facts in files.items() if facts["kind"] == "figure"}
    pictures = []
    for name, caption in captions.items():
        shown = f"figures/{name}.png"
        png = (ledger.folder / shown).read_bytes() if shown in files else b""
        kept = ", ".join(each for each in files if Path(each).stem == name)
        hidden = "" if png else ", not shown here: no PNG was kept"
        pictures.append(Picture(png, f"{caption} ({kept}{hidden})"))
    return pictures


def _read(ledger: Ledger, table: Table) -> pd.DataFrame:
    return read_frame(ledger.folder / "tables" / f"{table.name}.parquet")


def _show_rows(table: Table, frame: pd.DataFrame) -> list[Block]:
    """Return the first rows of a table, and what its columns mean."""
    shown = frame if len(frame) <= ROWS_SHOWN_WHOLE else frame.head(ROWS_OF_A_LONG_TABLE)
    described = [each for each in table.describe() if each[0] in frame.columns]
    units = {name: unit for name, unit, _ in described}
    grid = make_grid(shown, units, {name: meaning for name, _, meaning in described})
    return [("grid", grid), ("meanings", grid)]
