"""A sweep on the terminal, its table and its page: the sweep's folder flows in, text and two files flow out."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

from rich.console import Console

from pipeline.errors import PipelineError
from pipeline.failures import list_commands, list_reasons
from pipeline.printing import format_count, print_frame
from pipeline.review.selection import keep_rows, read_condition, sort_rows
from pipeline.review.sweep_page import FILE_NAME, describe_counts, write_sweep_page
from pipeline.review.sweep_view import Sweep, find_sweep
from pipeline.sweeps.sweep_table import write_frame
from pipeline.terminal import say

NOT_TOLD = ("done", "not begun", "running")


def review(options: argparse.Namespace, console: Console) -> None:
    """Print a sweep's jobs, failures and the commands that finish it; write ``sweep.parquet`` and ``sweep.html``.

    Parameters
    ----------
    options : Namespace
        ``outputs`` (folder), ``sweep`` (name or folder), and of the jobs to print, as the files hold all: ``where``,
        ``sort``, ``rows``, and ``all`` for columns that do not vary, too.
    console : Console
        Standard output.

    Raises
    ------
    PipelineError
        When there is no such sweep, or its folder cannot be written.
    """
    found = find_sweep(options.outputs, options.sweep)
    jobs = format_count(len(found.frame), "job")
    say(f"sweep {found.folder}: {jobs} ({describe_counts(found.counts)})", console)
    if found.alike and not options.all:
        say(f"the same in all: {', '.join(f'{key}={value}' for key, value in found.alike.items())}", console)
    chosen = sort_rows(keep_rows(found.frame, [read_condition(each) for each in options.where]), options.sort)
    table = found.table(options.all).loc[chosen.index]
    if options.all:
        table = table.drop(columns="error")
    print_frame("Jobs", table.rename(columns=found.head), console, options.rows, "--rows")
    for line in _describe_failures(found):
        say(line, console)
    try:
        say(f"table: {write_frame(found.folder, found.frame, found.units)}", console)
        write_sweep_page(found)
    except OSError as error:
        raise PipelineError(
            f"cannot write {error.filename2 or error.filename or found.folder}: {error.strerror}; jobs' own folders "
            "are as they are; make the folder writable, or copy it to where it is"
        ) from None
    say(f"page: {found.folder / FILE_NAME}", console)


def _describe_failures(found: Sweep) -> Iterator[str]:
    statuses = dict(zip(found.frame["job"], found.frame["status"], strict=True))
    unfinished = [job for job, status in statuses.items() if status != "done"]
    yield from list_reasons(found.folder, {job: statuses[job] for job in unfinished if statuses[job] not in NOT_TOLD})
    commands = list_commands(found.folder, unfinished)
    for command, count in commands:
        yield f"{_describe_unfinished(count, statuses)}; to finish, type: {command}"
    left = len(unfinished) - sum(count for _, count in commands)
    if left:
        yield f"{_describe_unfinished(left, statuses)}, and nothing says by which command"


def _describe_unfinished(count: int, statuses: dict[str, str]) -> str:
    return f"{count} of {len(statuses)} jobs {'is' if count == 1 else 'are'} not done"
