"""Looks at runs from the terminal: ``python -m pipeline.review list | show RUN | show RUN TABLE``.

The folder of runs flows in, text flows out; nothing is changed but by ``prune``, which is a module of its own.
"""

from __future__ import annotations

import argparse
import os
import sys

import pandas as pd
from rich.console import Console
from rich.markup import escape
from rich.padding import Padding

from pipeline.command import command_line, python_name
from pipeline.errors import ConfigError, PipelineError, suggest
from pipeline.ledger import FILE_NAME, Ledger
from pipeline.prune import add_prune, prune
from pipeline.report import print_frame
from pipeline.runs import find_run, list_folders, list_ledgers, live_status, runs_folder
from pipeline.table import read_frame
from pipeline.terminal import open_console

ROWS_SHOWN = 20


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m pipeline.review", description="Look at runs and their tables.")
    parser.add_argument("--outputs", default="outputs", metavar="PATH", help="the outputs folder (default: outputs)")
    commands = parser.add_subparsers(dest="command", required=True, metavar="list | show | prune")
    commands.add_parser("list", help="all runs, newest first")
    show = commands.add_parser("show", help="a run's stages, or the first rows of one of its tables")
    show.add_argument("run", metavar="RUN", help="its name, the beginning of its name, or latest")
    show.add_argument("table", metavar="TABLE", nargs="?", help="one of its tables")
    show.add_argument(
        "--rows", type=_count, default=ROWS_SHOWN, metavar="N", help=f"rows to print (default: {ROWS_SHOWN})"
    )
    add_prune(commands)
    options = parser.parse_args(arguments)
    console = open_console(piped_width=200)
    try:
        if options.command == "prune":
            return prune(options.outputs, options.keep, options.sweeps, options.dry_run, console)
        if options.command == "list":
            list_runs(options.outputs, console)
        elif options.table is None:
            show_run(find_run(options.outputs, options.run), console)
        else:
            show_table(find_run(options.outputs, options.run), options.table, options.rows, console)
    except PipelineError as error:
        open_console(stderr=True).print(str(error), soft_wrap=True, highlight=False, markup=False)
        return 2
    return 0


def list_runs(outputs: str, console: Console) -> None:
    """Print one line per run."""
    ledgers = list_ledgers(outputs)
    if not list_folders(outputs):
        console.print(f"no runs in {runs_folder(outputs)}; make one with: {command_line([])}", highlight=False)
        return
    rows = [
        {
            "run": each.name,
            "status": live_status(each),
            "stages": f"{sum(each.finished(name) is not None for name in each.records)} done",
            "command": each.facts["command"],
        }
        for each in ledgers
    ]
    known = {each.name for each in ledgers}
    for folder in sorted(list_folders(outputs), reverse=True):
        if folder.name not in known:
            status = "unreadable" if not os.access(folder, os.X_OK) or (folder / FILE_NAME).exists() else "no ledger"
            rows.append({"run": folder.name, "status": status, "stages": "-", "command": "-"})
    print_frame(f"Runs in {runs_folder(outputs)}", pd.DataFrame(rows), console, limit=len(rows))


def show_run(ledger: Ledger, console: Console) -> None:
    """Print how a run went and which tables it holds."""
    console.print(f"{ledger.folder}  {live_status(ledger)}", highlight=False)
    console.print(f"command: {ledger.facts['command']}", soft_wrap=True, highlight=False, markup=False)
    error = ledger.facts["error"]
    if error:
        console.print(f"{error['stage']}: {error['message']}", soft_wrap=True, highlight=False, markup=False)
    width = max((len(name) for name in ledger.records), default=0)
    for name, record in ledger.records.items():
        seconds = f"{record['seconds']:.1f} s" if "seconds" in record else "-"
        origin = "made here" if record["origin"] == ledger.name else f"made in {record['origin']}"
        tables = ", ".join(f"{table} ({facts['rows']})" for table, facts in record["tables"].items())
        console.print(f"[bold]{name:<{width}}[/bold]  {record['status']}, {seconds}, {origin}", highlight=False)
        for text in (f"because: {escape(record['reason'])}", f"tables (rows): {tables or '-'}"):
            console.print(Padding(text, (0, 0, 0, width + 2)), highlight=False)
    console.print(f"a table: {python_name()} -m pipeline.review show {ledger.name} TABLE", highlight=False)


def show_table(ledger: Ledger, name: str, rows: int, console: Console) -> None:
    """Print the first rows of one table of a run."""
    known = [table for record in ledger.records.values() for table in record["tables"]]
    if name not in known:
        raise ConfigError(f"run {ledger.name} has no table '{name}'; {suggest(name, known)}")
    path = ledger.folder / "tables" / f"{name}.parquet"
    print_frame(str(path), read_frame(path), console, limit=rows)


def _count(text: str) -> int:
    if not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a number from 1, got {text}")
    return int(text)


if __name__ == "__main__":
    sys.exit(main())
