"""Runs and sweeps copied to a tracker afterwards: their folders flow in, a line for each that was sent flows out."""

import argparse
from pathlib import Path

from rich.console import Console

from pipeline.config import read_tracking
from pipeline.errors import PipelineError
from pipeline.printing import format_counts
from pipeline.runs import find_run, list_folders, sweeps_folder
from pipeline.terminal import say
from pipeline.tracking.destination import find_destination
from pipeline.tracking.entries import is_sweep

REQUEST_S, RETRIES = 30.0, 2
"""Longest wait for an answer of a server, s, and how often it is asked again."""


def review(options: argparse.Namespace, console: Console) -> None:
    """Send runs and sweeps, all of them where none is named; raise `PipelineError` where that does not succeed."""
    given = {name: value for name in ("uri", "experiment") if (value := getattr(options, name)) is not None}
    tracking = read_tracking(options.to, given)
    folders = _choose_folders(options.outputs, options.runs)
    destination = find_destination(options.outputs, tracking)
    from pipeline.tracking.mlflow_store import Store  # which takes seconds

    try:
        store = Store(destination, tracking.largest_file_mb, REQUEST_S, RETRIES)
        for folder in folders:
            counts = store.send(folder)
            destination.clear(folder)
            say(f"{folder}: {format_counts(counts)}", console)
    except Exception as error:
        why = (str(error).splitlines() or [type(error).__name__])[0]
        raise PipelineError(f"not sent to MLflow: {why}; when that is mended, type the same again") from error
    say(f"to look at it: {destination.look()}", console)


def _choose_folders(outputs: str, names: list[str]) -> list[Path]:
    """Return the folders of runs, jobs and sweeps of these names; without any, of all runs and sweeps."""
    sweeps = sweeps_folder(outputs)
    if not names:
        found = list_folders(outputs)
        return sorted({each.parent if each.parent.parent == sweeps else each for each in found})
    chosen = [(name, sweeps / name.rstrip("/")) for name in names]
    return [each if is_sweep(each) and each.is_dir() else find_run(outputs, name).folder for name, each in chosen]
