"""report.html and the terminal's final tables: what a run found, readable by someone who was not there.

A run's ledger, tables and figures flow in; one self-contained page flows out, with no request to any other place.
"""

import logging
from collections.abc import Sequence
from itertools import starmap
from pathlib import Path
from typing import Any

import pandas as pd
from omegaconf import OmegaConf
from rich.console import Console

from pipeline.checkout import describe_commit
from pipeline.command import complete
from pipeline.config import Study
from pipeline.failures import describe_reason, read_traceback
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
from pipeline.printing import (
    ROWS_SHOWN_WHOLE,
    add_unit,
    format_count,
    format_value,
    join_some,
    print_frame,
    print_sentences,
    show_metric,
)
from pipeline.stage import Stage, list_tables
from pipeline.table import TITLES, Table, read_frame

log = logging.getLogger("pamid")

PAGE_NAME = "report.html"
ROWS_OF_A_LONG_TABLE = 6


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
    pictures = _order_pictures(ledger, done, headline)
    workflow = study.settings.workflow.name.replace("_", " ")
    path = ledger.folder / PAGE_NAME
    write_page(
        path,
        title=f"{workflow} {ledger.name}",
        heading=workflow[:1].upper() + workflow[1:],
        lead=f"Run {ledger.name}",
        status=status,
        opening=_show_failure(ledger, status),
        sections=[
            Section("Found", _show_finding(ledger, headline, pictures[:1])),
            Section("Pictures", [("pictures", pictures[1:])] if pictures[1:] else []),
            Section("Tables", [block for each in headline for block in _show_headline(ledger, each)]),
            Section("How it was made", _show_making(ledger, study, stages, reached)),
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


def headline_tables(study: Study, stages: Sequence[Stage]) -> list[Table]:
    """Return the contracts of the tables that the workflow wants seen first, as far as the stages write them."""
    by_name = list_tables(stages)
    return [by_name[name] for name in study.settings.workflow.headline if name in by_name]


def print_headline(ledger: Ledger, study: Study, stages: Sequence[Stage], console: Console) -> None:
    """Print the headline tables of a run that have rows; what was found, and what to do next, last."""
    headline = headline_tables(study, [each for each in stages if ledger.finished(each.name)])
    for table in headline:
        frame = _read(ledger, table)
        if table.role == "data" and len(frame):
            kept, told = _shorten(table, frame)
            shown, units = table.show(kept)
            heads = [add_unit(name, "%") if units[name] == "%" else name for name in shown.columns]
            print_frame(table.title, shown.set_axis(heads, axis="columns"), console)
            if told:
                print_sentences([told], console)
    for role, title in TITLES.items():
        if sentences := _list_sentences(ledger, headline, role):
            console.print(title, style="bold")
            print_sentences(sentences, console)


def _shorten(table: Table, frame: pd.DataFrame) -> tuple[pd.DataFrame, str]:
    """Return the columns and rows that decide, and in words which rows are left out."""
    kept, told = frame, ""
    if table.main and (main := frame[table.main[0]] == table.main[1]).any():
        kept = frame[main]
    elif table.minor and (below := frame[table.minor[0]] < table.minor[1]).sum() > 1:
        kept = frame[~below]
        names = frame.select_dtypes(exclude="number").iloc[:, 0].astype(str).str.replace("_", " ")
        others = [each for each in dict.fromkeys(names[below]) if each not in set(names[~below])]
        if others:
            told = f"{len(others)} others have a {table.minor[0].replace('_', ' ')} below {table.minor[1]:g}: "
            told += f"{join_some(others, 4)}."
    return kept[list(table.brief or frame.columns)], told


def _list_sentences(ledger: Ledger, headline: Sequence[Table], role: str) -> list[str]:
    """Return what tables of a role say, with commands as they can be typed after this run."""
    frames = [_read(ledger, each) for each in headline if each.role == role]
    facts, folder = ledger.facts, str(ledger.folder)
    typed = str(facts.get("rerun_of", facts).get("command", facts["command"]))
    return [complete(each, typed, folder) for frame in frames for each in list_sentences(frame)]


def _order_pictures(ledger: Ledger, done: Sequence[Stage], headline: Sequence[Table]) -> list[Picture]:
    """Return all pictures, first those of the stages that write headline tables, in the order of these."""
    writers = {table.name: each.name for each in done for table in each.writes}
    names = dict.fromkeys([*(writers[table.name] for table in headline), *(each.name for each in done)])
    return [picture for name in names for picture in _list_pictures(ledger, name)]


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
    return [
        ("Started", ledger.facts["started"]),
        ("Machine", f"{machine['system']}, {machine['cores']} cores, Python {machine['python']}"),
        *([("Code", describe_commit(git))] if git else []),
        *((head, format_value(value)) for head, value in starmap(show_metric, ledger.metrics.items())),
    ]


def _show_failure(ledger: Ledger, status: str) -> list[Block]:
    if not ledger.facts["error"]:
        return []
    traceback = read_traceback(ledger.folder) if status == "failed" else ""
    kept = any(map(ledger.finished, ledger.records))
    goes_on = "What was done before is kept; this goes on from there" if kept else "This goes on"
    blocks: list[Block] = [
        ("status", (status, describe_reason(ledger, status))),
        ("note", f"{goes_on}, when that is mended:"),
        ("command", ledger.facts["command"]),
    ]
    return [("failure", blocks + show_traceback("traceback", traceback, is_open=True))]


def _show_finding(ledger: Ledger, headline: Sequence[Table], pictures: Sequence[Picture]) -> list[Block]:
    """Return what was found, the picture that shows it, what to do next, and what to bear in mind."""
    found = {role: _list_sentences(ledger, headline, role) for role in TITLES}
    told: list[Block] = [("finding", found["finding"])] if found["finding"] else []
    shown: list[Block] = [("pictures", pictures)] if pictures else []
    if found["advice"]:
        shown += [("heading", TITLES["advice"]), ("prose", found["advice"])]
    if found["remark"]:
        title = f"{TITLES['remark']} ({len(found['remark'])})"
        shown.append(make_details(title, [("prose", found["remark"])]))
    return [("beside", (told, shown))] if told and pictures else told + shown


def _show_headline(ledger: Ledger, table: Table) -> list[Block]:
    """Return the columns and rows of a table that decide, and the rest for who asks for it."""
    frame = _read(ledger, table)
    if table.role != "data" or frame.empty:
        return []
    kept, told = _shorten(table, frame)
    blocks: list[Block] = [("heading", table.title), ("grid", _make_grid(table, kept))]
    blocks += [("note", told)] if told else []
    whole = kept.shape == frame.shape
    size = f"{format_count(len(frame), 'row')} and {len(frame.columns)} columns"
    summary = "what the columns mean" if whole else f"all {size}, and what they mean"
    rows = _show_rows(table, frame)
    return [*blocks, make_details(summary, rows[-1:] if whole else rows)]


def _show_making(ledger: Ledger, study: Study, stages: Sequence[Stage], reached: Sequence[Stage]) -> list[Block]:
    """Return by which command, on what, and from which stages and configuration a run was made."""
    done = [each for each in reached if ledger.finished(each.name)]
    configuration = OmegaConf.to_yaml(OmegaConf.create(study.values))
    return [
        ("command", ledger.facts["command"]),
        ("facts", _list_facts(ledger)),
        make_details("plan: what each stage did, and why", [("grid", _make_plan(ledger, stages, reached))]),
        *(make_details(f"{each.name}: {each.summary}", _show_stage(ledger, each)) for each in done),
        make_details("configuration", [("text", configuration)]),
    ]


def _show_stage(ledger: Ledger, stage: Stage) -> list[Block]:
    record = ledger.records[stage.name]
    made = f"Made in {record.get('seconds')} s: {record['reason']}."
    if record["origin"] != ledger.name:
        made = f"Made in run {record['origin']} and reused."
    blocks: list[Block] = [("note", made)]
    for table in stage.writes:
        frame = _read(ledger, table)
        part = "" if len(frame) <= ROWS_SHOWN_WHOLE else f", the first {ROWS_OF_A_LONG_TABLE} here"
        note = f"{table.title}. {format_count(len(frame), 'row')}{part}; tables/{table.name}.parquet"
        blocks += [("heading", table.name), ("note", note), *(_show_rows(table, frame) if len(frame) else [])]
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
    return [("grid", _make_grid(table, shown)), ("meanings", _make_grid(table, frame.head(0)))]


def _make_grid(table: Table, frame: pd.DataFrame) -> dict[str, Any]:
    shown, units = table.show(frame)
    return make_grid(shown, units, {name: each["description"] for name, each in table.columns.items()})
