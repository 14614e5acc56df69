"""sweep.html: all of a sweep on one page, beside its jobs' folders. A sweep flows in; text flows out."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from typing import Any

import pandas as pd

from pipeline.failures import list_commands, read_traceback, tell_reason
from pipeline.files import write_text
from pipeline.launch import list_launches
from pipeline.ledger import Ledger
from pipeline.page import link_to, make_grid, make_rows, render
from pipeline.printing import is_prose
from pipeline.review.comparison import Comparison
from pipeline.review.kept import list_headlines, read_config, read_short_tables
from pipeline.review.sweep_view import AS_CONFIGURED, Sweep

FILE_NAME = "sweep.html"
MOST_VALUES = 12
MOST_DIFFERENCES = 200
MOST_JOBS_WITH_RESULTS = 12
MOST_ROWS_OF_RESULTS = 12
MOST_KINDS = 20
MOST_JOBS_OF_A_KIND = 20
MOST_COMMANDS = 5


def write_page(sweep: Sweep) -> None:
    """Write ``sweep.html`` into a sweep's folder.

    Raises
    ------
    OSError
        When the folder cannot be written.
    """
    ledgers = {job: found for job in sweep.frame["job"] if (found := Ledger.look(sweep.folder / job))}
    statuses = dict(zip(sweep.frame["job"], sweep.frame["status"], strict=True))
    unfinished = {job: status for job, status in statuses.items() if status != "done"}
    failed = {job: status for job, status in unfinished.items() if status not in ("not begun", "running")}
    kinds = _list_failures(sweep, ledgers, failed)
    done = [ledgers[job] for job, status in statuses.items() if status == "done"]
    table = sweep.table(everything=False)
    if table.columns[0] != "job":
        table = table.assign(job=sweep.frame["job"])[["job", *table.columns]]
    links = [_link(sweep, job) for job in table["job"]]
    results = list(islice(_list_results(done), MOST_JOBS_WITH_RESULTS))
    page = render(
        "sweep.html.j2",
        name=sweep.name,
        jobs=len(sweep.frame),
        told=tell_counts(sweep.counts),
        unfinished=len(unfinished),
        commands=[str(each.get("command", "-")) for each in list_launches(sweep.folder)][-MOST_COMMANDS:],
        facts=_list_facts([*ledgers.values()]),
        axes=_list_axes(sweep),
        counts=make_rows(["status", "jobs"], sweep.counts.items()),
        alike=sweep.alike,
        metrics=_draw(sweep),
        table=make_grid(table, sweep.units, links=links),
        finishing=list_commands(sweep.folder, unfinished),
        failures=kinds[:MOST_KINDS],
        kinds_left=len(kinds[MOST_KINDS:]),
        results=results,
        results_left=len(done) > len(results),
        differences=_list_differences(sweep, done or [*ledgers.values()]),
    )
    write_text(sweep.folder / FILE_NAME, page)


def tell_counts(counts: dict[str, int]) -> str:
    """Return jobs by status in words."""
    return ", ".join(f"{count} {status}" for status, count in counts.items())


def _draw(sweep: Sweep) -> list[Any]:
    if not sweep.metrics:
        return []
    from pipeline.review.metric_drawing import draw_metrics

    return list(draw_metrics(sweep))


def _link(sweep: Sweep, job: str) -> str:
    return link_to(job, "report.html") if (sweep.folder / job / "report.html").is_file() else ""


def _list_facts(ledgers: Sequence[Ledger]) -> list[tuple[str, str]]:
    started = [str(each.facts["started"]) for each in ledgers]
    ended = [str(each.facts["ended"]) for each in ledgers if each.facts["ended"]]
    seconds = sum(float(each.facts.get("seconds") or 0.0) for each in ledgers)
    facts = [("Started", min(started))] if started else []
    facts += [("Last ended", max(ended))] if ended else []
    return [*facts, ("Work", f"{seconds:.1f} s in all jobs together")]


def _list_axes(sweep: Sweep) -> dict[str, Any]:
    rows = []
    for key, values in sweep.varying.items():
        counts = sweep.frame[key].where(sweep.frame[key].notna(), AS_CONFIGURED).astype(str).value_counts()
        shown = ", ".join(f"{value} ({counts[value]})" for value in values[:MOST_VALUES])
        more = f" and {len(values) - MOST_VALUES} more" if len(values) > MOST_VALUES else ""
        rows.append([key, len(values), shown + more, "repeats" if key in sweep.seeds else "axis"])
    return make_rows(["key", "values", "value (jobs)", "taken for"], rows)


def _list_failures(sweep: Sweep, ledgers: dict[str, Ledger], failed: dict[str, str]) -> list[dict[str, Any]]:
    """Return failures by kind: status, stage, and the traceback up to its last line."""
    kinds: dict[tuple[str, ...], dict[str, Any]] = {}
    for job, status in failed.items():
        reason = tell_reason(ledgers.get(job), status)
        traceback = read_traceback(sweep.folder / job) if status == "failed" else ""
        where = traceback.rpartition("\n")[0] or reason
        found = kinds.setdefault((status, where), {"status": status, "traceback": traceback, "jobs": [], "reasons": {}})
        found["jobs"].append((job, _link(sweep, job)))
        found["reasons"][reason] = None
    for each in kinds.values():
        reasons = list(each["reasons"])
        each["reason"] = "; ".join(reasons[:3]) + (f"; and {len(reasons) - 3} more" if len(reasons) > 3 else "")
        each["more"] = len(each["jobs"][MOST_JOBS_OF_A_KIND:])
        each["jobs"] = each["jobs"][:MOST_JOBS_OF_A_KIND]
    return list(kinds.values())


def _list_results(done: Sequence[Ledger]) -> Any:
    for ledger in done:
        names = list_headlines(read_config(ledger.folder))
        tables = [
            {**make_grid(frame, units), "title": title, "prose": is_prose(frame)}
            for frame, units, title in read_short_tables(ledger, names, MOST_ROWS_OF_RESULTS)
        ]
        if tables:
            yield ledger.folder.name, tables


def _list_differences(sweep: Sweep, ledgers: Sequence[Ledger]) -> dict[str, Any]:
    """Return what jobs differ in beyond their overrides, each value with the number of jobs that have it."""
    found = Comparison(tuple(ledgers), most=0, whole=False)
    frame = found.configuration().set_axis(["key", "value (jobs)"], axis="columns")
    around = found.surroundings().set_axis(frame.columns, axis="columns")
    return make_grid(pd.concat([frame[~frame["key"].isin(sweep.keys)], around]).head(MOST_DIFFERENCES))
