"""A sweep on the terminal, its table and its page: the sweep's folder flows in, text and two files flow out."""

import argparse
from collections.abc import Sequence
from typing import Any
from urllib.parse import quote

import pandas as pd
from rich.console import Console

from pipeline.command import complete
from pipeline.errors import PipelineError
from pipeline.failures import describe_reason, list_commands, list_reasons, read_traceback
from pipeline.ledger import Ledger
from pipeline.page import Block, Section, list_sentences, make_details, make_grid, make_rows, show_traceback, write_page
from pipeline.printing import add_unit, format_count, format_counts, is_prose, join_some, print_frame
from pipeline.review.compare import Comparison
from pipeline.review.kept import list_headlines, list_tables, read_config, read_whole_table
from pipeline.review.selection import keep_rows, read_condition, sort_rows
from pipeline.review.sweep_view import Sweep, describe_extremes, find_sweep, propose_seeds
from pipeline.sweeps.launch import list_launches
from pipeline.sweeps.sweep_table import write_frame
from pipeline.table import TITLES
from pipeline.terminal import say

FILE_NAME = "sweep.html"
MOST_VALUES = 12
MOST_DIFFERENCES = 200
MOST_JOBS_WITH_RESULTS = 12
MOST_ROWS_OF_RESULTS = 12
MOST_JOBS_OF_A_KIND = 20
MOST_COMPARED = 200
MOST_COMMANDS = 5


def review(options: argparse.Namespace, console: Console) -> None:
    """Print a sweep's jobs, failures and the commands that finish it; write ``sweep.parquet`` and ``sweep.html``.

    The files hold all jobs; options say which rows and columns are printed. It raises `PipelineError` where there is no
    such sweep, or its folder cannot be written.
    """
    found = find_sweep(options.outputs, options.sweep)
    say(f"sweep {found.folder}: {format_count(len(found.frame), 'job')} ({format_counts(found.counts)})", console)
    if found.alike and not options.all:
        say(f"the same in all: {', '.join(f'{key}={value}' for key, value in found.alike.items())}", console)
    chosen = sort_rows(keep_rows(found.frame, [read_condition(each) for each in options.where]), options.sort)
    table = found.table(options.all).loc[chosen.index]
    if options.all:
        table = table.drop(columns="error")
    heads = {name: add_unit(name, unit) for name, unit in found.units.items()}
    print_frame("Jobs", table.rename(columns=heads), console, options.rows, "--rows")
    for line in list_reasons(found.folder, found.failed):
        say(line, console)
    left = len(found.unfinished)
    for command, count in list_commands(found.folder, found.unfinished):
        say(f"{_describe_unfinished(count, found)}; to finish, type: {command}", console)
        left -= count
    if left:
        say(f"{_describe_unfinished(left, found)}, and nothing says by which command", console)
    try:
        say(f"table: {write_frame(found.folder, found.frame, found.described)}", console)
        _write_page(found)
    except OSError as error:
        raise PipelineError(
            f"cannot write {error.filename2 or error.filename or found.folder}: {error.strerror}; jobs' own folders "
            "are as they are; make the folder writable, or copy it to where it is"
        ) from None
    say(f"page: {found.folder / FILE_NAME}", console)


def _describe_unfinished(count: int, found: Sweep) -> str:
    return f"{count} of {len(found.frame)} jobs {'is' if count == 1 else 'are'} not done"


def _write_page(sweep: Sweep) -> None:
    jobs = sweep.frame["job"][sweep.frame["started"].notna()]
    done = [job for job in jobs if job not in sweep.unfinished]
    launches = [*list_launches(sweep.folder)][-MOST_COMMANDS:]
    shown: list[Block] = [("command", str(each.get("command", "-"))) for each in launches]
    told = describe_extremes(sweep)
    typed = launches[-1].get("arguments") if launches else None
    more: list[Block] = []
    if typed and any(each in one for each in ("not told apart", "so few", "no seed") for one in told):
        more = [("heading", TITLES["advice"]), ("prose", [propose_seeds(sweep, typed)])]
    making = [*shown, ("facts", _list_facts(sweep)), *_show_plan(sweep)]
    making.append(make_details("differences", _show_differences(sweep, done or [*jobs])))
    write_page(
        sweep.folder / FILE_NAME,
        title=f"sweep {sweep.folder.name}",
        heading=f"Sweep {sweep.folder.name}",
        lead=f"{format_count(len(sweep.frame), 'job')}: {format_counts(sweep.counts)}",
        status=f"{len(sweep.unfinished)} not done" if sweep.unfinished else "done",
        opening=[],
        sections=[
            Section("Found", [("finding", told), *more] if told else []),
            Section("Failures", _show_failures(sweep)),
            Section("Metrics", _show_metrics(sweep)),
            Section("Jobs", _show_jobs(sweep)),
            Section("Results", _show_results(sweep, done)),
            Section("How it was made", making),
        ],
    )


def _show_plan(sweep: Sweep) -> list[Block]:
    blocks: list[Block] = [("note", "No key varies between the jobs.")]
    if sweep.varying:
        blocks = [("note", "Keys that vary, and how many jobs have each value."), ("grid", _list_axes(sweep))]
    blocks += [("heading", "Jobs by status"), ("grid", make_rows(["status", "jobs"], sweep.counts.items()))]
    if sweep.alike:
        blocks.append(make_details("the same in all jobs", [("facts", [*sweep.alike.items()])]))
    return blocks


def _show_metrics(sweep: Sweep) -> list[Block]:
    if not sweep.metrics:
        return []
    from pipeline.review.drawing import draw_metrics

    drawn = [*draw_metrics(sweep)]
    pictures = [each for _, found, _ in drawn for each in found]
    notes: list[Block] = [("note", f"{head}: {told}.") for head, _, told in drawn if told]
    return [("pictures", pictures), *notes]


def _show_jobs(sweep: Sweep) -> list[Block]:
    table = sweep.table(everything=False)
    if table.columns[0] != "job":
        table = table.assign(job=sweep.frame["job"])[["job", *table.columns]]
    links = [_link(sweep, job) for job in table["job"]]
    note = "A heading sorts by its column, again the other way round. A job's link leads to its own report."
    return [("note", note), ("sortable", make_grid(table, sweep.units, links=links))]


def _link(sweep: Sweep, job: str) -> str:
    """Return the relative address of a job's report."""
    return f"./{quote(job)}/report.html" if (sweep.folder / job / "report.html").is_file() else ""


def _list_facts(sweep: Sweep) -> list[tuple[str, str]]:
    started, ended = (sweep.frame[name].dropna() for name in ("started", "ended"))
    facts = [("Started", str(started.min()))] if len(started) else []
    facts += [("Last ended", str(ended.max()))] if len(ended) else []
    return [*facts, ("Work", f"{sweep.frame['wall_s'].sum():.1f} s in all jobs together")]


def _list_axes(sweep: Sweep) -> dict[str, Any]:
    rows = []
    for key, values in sweep.varying.items():
        counts = sweep.texts(key).value_counts()
        shown = join_some([f"{value} ({counts[value]})" for value in values], MOST_VALUES)
        rows.append([key, len(values), shown, "repeats" if key in sweep.seeds else "axis"])
    return make_rows(["key", "values", "value (jobs)", "taken for"], rows)


def _show_failures(sweep: Sweep) -> list[Block]:
    """Return what finishes a sweep, and its failures by kind: by status and the traceback up to its last line."""
    kinds: dict[tuple[str, str], list[tuple[str, str, str]]] = {}
    for job, status in sweep.failed.items():
        reason = describe_reason(Ledger.look(sweep.folder / job), status)
        traceback = read_traceback(sweep.folder / job) if status == "failed" else ""
        kinds.setdefault((status, traceback.rpartition("\n")[0] or reason), []).append((job, reason, traceback))
    blocks: list[Block] = []
    for command, count in list_commands(sweep.folder, sweep.unfinished) if kinds else []:
        note = f"This finishes {format_count(count, 'job')}, when that is mended:"
        blocks += [("note", note), ("command", command)]
    for (status, _), found in kinds.items():
        reasons = list(dict.fromkeys(reason for _, reason, _ in found))
        told = "; ".join(reasons[:3]) + (f"; and {len(reasons) - 3} more" if len(reasons) > 3 else "")
        jobs = [(job, _link(sweep, job)) for job, _, _ in found[:MOST_JOBS_OF_A_KIND]]
        shown: list[Block] = [("status", (status, told)), ("links", jobs)]
        shown += [("note", f"and {len(found) - len(jobs)} more")] if len(found) > len(jobs) else []
        summary = "traceback of the first" if len(found) > 1 else "traceback"
        is_first = not any(kind == "failure" for kind, _ in blocks)
        blocks.append(("failure", shown + show_traceback(summary, found[0][2], is_open=is_first)))
    return blocks


def _show_results(sweep: Sweep, done: Sequence[str]) -> list[Block]:
    """Return what the reports of the first jobs begin with: sentences, or short tables where there are none."""
    results: list[Block] = []
    for ledger in _look_at(sweep, done[:MOST_JOBS_WITH_RESULTS]):
        kept = list_tables(ledger)
        names = [each for each in list_headlines(read_config(ledger.folder)) if each in kept]
        short = [each for each in names if 0 < int(kept[each].get("rows", 0)) <= MOST_ROWS_OF_RESULTS]
        read = [found for name in short if (found := read_whole_table(ledger, name))]
        prose = [each for each in read if is_prose(each[0])]
        typed, folder = str(ledger.facts["command"]), str(ledger.folder)
        blocks: list[Block] = []
        for frame, units, title in prose or read:
            sentences = [complete(each, typed, folder) for each in list_sentences(frame)] if prose else []
            blocks += [("heading", title), ("prose", sentences) if prose else ("grid", make_grid(frame, units))]
        if blocks:
            results.append(make_details(ledger.folder.name, blocks, is_open=not results))
    if not results:
        return []
    part = f", of the first {len(results)} jobs that are done" if len(done) > len(results) else ""
    return [("note", f"What each job's report begins with{part}."), *results]


def _show_differences(sweep: Sweep, jobs: Sequence[str]) -> list[Block]:
    """Return what jobs differ in beyond their overrides, each value with the number of jobs that have it."""
    every = max(1, -(-len(jobs) // MOST_COMPARED))
    found = Comparison(tuple(_look_at(sweep, jobs[::every])), most=0, whole=False)
    frame = found.configuration().set_axis(["key", "value (jobs)"], axis="columns")
    around = found.surroundings().set_axis(frame.columns, axis="columns")
    rows = pd.concat([frame[~frame["key"].isin(sweep.keys)], around]).head(MOST_DIFFERENCES)
    note = "Keys of the configuration that stages read and in which jobs differ, beyond what the command says; then "
    note += "code, libraries and machines."
    note += f" Looked at is one job in {every}." if every > 1 else ""
    return [("note", note), ("grid", make_grid(rows)) if len(rows) else ("note", "None.")]


def _look_at(sweep: Sweep, jobs: Sequence[str]) -> list[Ledger]:
    return [found for job in jobs if (found := Ledger.look(sweep.folder / job))]
