"""Looks at runs and sweeps: ``python -m pipeline.review list | show | compare | sweep | export | prune``.

The folder of outputs flows in, text flows out, and a page where one is made; no run is changed but by ``prune``.
"""

import argparse
import gc
import sys
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.padding import Padding

from pipeline.command import command_line, review_line
from pipeline.errors import ConfigError, PipelineError, suggest
from pipeline.ledger import Ledger
from pipeline.printing import print_frame
from pipeline.review.selection import put_sort_together
from pipeline.runs import find_run, live_status
from pipeline.terminal import complain, open_console, say

ROWS_SHOWN = 20
ROWS_OF_A_LIST = 40
OUTPUTS_HELP = "the outputs folder (default: outputs)"


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    options = _make_parser().parse_args(put_sort_together(sys.argv[1:] if arguments is None else arguments))
    console = open_console(piped_width=200)
    try:
        if not any(Path(each).is_dir() for each in (options.outputs, getattr(options, "sweep", options.outputs))):
            raise ConfigError(
                f"no outputs folder {options.outputs}; make one with: {command_line([])}, or name another"
            )
        return options.act(options, console) or 0
    except PipelineError as error:
        complain(str(error))
        return 2


def show(options: argparse.Namespace, console: Console) -> None:
    """Print how a run went, or one of its tables."""
    from pipeline.table import read_frame

    ledger = find_run(options.outputs, options.run)
    if options.table is None:
        _show_run(ledger, options.outputs, console)
        return
    known = [table for record in ledger.records.values() for table in record["tables"]]
    if options.table not in known:
        raise ConfigError(f"run {ledger.name} has no table '{options.table}'; {suggest(options.table, known)}")
    path = ledger.folder / "tables" / f"{options.table}.parquet"
    print_frame(str(path), read_frame(path), console, options.rows, "--rows")


def _show_run(ledger: Ledger, outputs: str, console: Console) -> None:
    """Print how a run went and which tables it holds."""
    live = live_status(ledger)
    say(f"{ledger.folder}  {live}", console)
    say(f"command{'' if live in ('done', 'running') else ', which goes on'}: {ledger.facts['command']}", console)
    if error := ledger.facts["error"]:
        say(f"{error['stage']}: {error['message']}", console)
    width = max((len(name) for name in ledger.records), default=0)
    for name, record in ledger.records.items():
        seconds = f"{record['seconds']:.1f} s" if "seconds" in record else "-"
        origin = "made here" if record["origin"] == ledger.name else f"made in {record['origin']}"
        tables = ", ".join(f"{table} ({facts['rows']})" for table, facts in record["tables"].items())
        status = live if record["status"] == "running" else record["status"]
        told = f"{status}, {seconds}, {escape(origin)}"
        console.print(f"[bold]{name:<{width}}[/bold]  {told}", highlight=False)
        for text in (f"because: {escape(record['reason'])}", f"tables (rows): {tables or '-'}"):
            console.print(Padding(text, (0, 0, 0, width + 2)), highlight=False)
    say(f"a table: {review_line(outputs, 'show', ledger.name, 'TABLE')}", console)


def _make_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m pipeline.review", description="Look at runs and their tables.")
    parser.add_argument("--outputs", default="outputs", metavar="PATH", help=OUTPUTS_HELP)
    commands = parser.add_subparsers(
        dest="command", required=True, metavar="list | show | compare | sweep | export | prune"
    )

    def add(name: str, told: str, act: Callable[[argparse.Namespace, Console], int | None]) -> argparse.ArgumentParser:
        command = commands.add_parser(name, help=told, description=f"{told[0].upper()}{told[1:]}.")
        command.add_argument("--outputs", default=argparse.SUPPRESS, metavar="PATH", help=OUTPUTS_HELP)
        command.set_defaults(act=act)
        return command

    listing = add("list", "all runs and sweeps, newest first", _act_of("listing"))
    listing.add_argument("--jobs", action="store_true", help="each job of a sweep on a line of its own")
    _add_selection(listing)
    shown = add("show", "a run's stages, or the first rows of one of its tables", show)
    shown.add_argument("run", metavar="RUN", help="its name, the beginning of its name, SWEEP/JOB, or latest")
    shown.add_argument("table", metavar="TABLE", nargs="?", help="one of its tables")
    _add_rows(shown, ROWS_SHOWN)
    compared = add("compare", "how runs differ, as text and as a page with their curves", _act_of("compare"))
    compared.add_argument(
        "runs", metavar="RUN", nargs="+", help="as of show; or a sweep, for all its jobs that are done"
    )
    compared.add_argument("--all", action="store_true", help="list also what is the same in all")
    compared.add_argument("--html", metavar="PATH", help="the page (default: outputs/reviews/compare-RUN_vs_RUN.html)")
    compared.add_argument(
        "--rows",
        type=_count,
        metavar="N",
        help="list so many rows of each table that differs (default: how many differ)",
    )
    swept = add("sweep", "a sweep: its jobs, failures and metrics, as text and as a page", _act_of("sweep"))
    swept.add_argument("sweep", metavar="DIR|NAME", help="its name, its folder, or latest")
    swept.add_argument("--all", action="store_true", help="all columns, not those alone that vary")
    _add_selection(swept)
    exported = add("export", "copy runs and sweeps to where colleagues look", _act_of("export"))
    exported.add_argument("runs", metavar="RUN|SWEEP", nargs="*", help="as of show, or a sweep's name (default: all)")
    exported.add_argument("--to", required=True, choices=["mlflow"], help="what they are copied to")
    exported.add_argument(
        "--uri", help="of a server or store, as of tracking.uri (default: a store in the outputs folder)"
    )
    exported.add_argument("--experiment", metavar="NAME", help="MLflow's experiment (default: pamid)")
    from_0 = partial(_count, least=0)
    pruned = add("prune", "remove all but the newest runs, and those that something needs", _act_of("prune"))
    pruned.add_argument("--keep", type=from_0, required=True, metavar="N", help="runs to keep, the newest")
    pruned.add_argument("--sweeps", type=from_0, metavar="N", help="whole sweeps to keep; without it all stay")
    pruned.add_argument("--dry-run", action="store_true", help="say what would be removed; change nothing")
    return parser


def _act_of(module: str) -> Callable[[argparse.Namespace, Console], int | None]:
    """Return what runs a command of a module's own, which is imported only then."""
    return lambda options, console: import_module(f"pipeline.review.{module}").review(options, console)


def _add_selection(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--sort", metavar="COLUMN", help="sort by it; -COLUMN: largest first")
    parser.add_argument(
        "--where",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="these rows alone; also KEY!=VALUE, KEY~TEXT (contains), 'KEY<NUMBER', 'KEY>NUMBER'; may be repeated",
    )
    _add_rows(parser)


def _add_rows(parser: argparse.ArgumentParser, rows: int = ROWS_OF_A_LIST) -> None:
    parser.add_argument("--rows", type=_count, default=rows, metavar="N", help=f"rows to print (default: {rows})")


def _count(text: str, least: int = 1) -> int:
    if not text.isdigit() or int(text) < least:
        raise argparse.ArgumentTypeError(f"expected a number from {least}, got {text}")
    return int(text)


if __name__ == "__main__":
    try:
        sys.exit(main())
    finally:
        gc.freeze()  # looking for cycles among all objects at the end took a fifth of a command
