"""Removes old runs: ``python -m pipeline.review prune --keep N``; what is at work, measured or needed stays.

A folder goes in two steps, a new name that nothing looks at, then its files: a killed process leaves no half of a run.
"""

import argparse
import os
import shutil
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout
from rich.console import Console
from rich.filesize import decimal

from pipeline.config import find_target
from pipeline.flat import walk
from pipeline.ledger import Ledger
from pipeline.printing import format_count
from pipeline.review.kept import read_yaml
from pipeline.runs import LOCK_NAME, is_running, list_folders, list_within, live_status, runs_folder, sweeps_folder
from pipeline.sweeps.launch import is_launched
from pipeline.terminal import complain, say

HIDDEN = ".pruned-"
MOST_LOCKS = 200
"""Locks that are held at once; a process may open few more files."""


@dataclass
class Unit:
    """What is kept or removed as one: a run, or a sweep with the folders and the readable ledgers of its jobs."""

    folder: Path
    runs: list[Path]
    ledgers: list[Ledger]


def review(options: argparse.Namespace, console: Console) -> int:
    """Remove the runs that are neither among the newest nor at work, measured or needed; return the exit code.

    It is 1 where a folder could not be removed. `PipelineError` says that the outputs folder cannot be read.
    """

    def remove(folder: Path, files: Sequence[os.stat_result]) -> None:
        try:
            if not dry_run:
                for within, _, _ in os.walk(folder):
                    os.chmod(within, 0o700)
                shutil.rmtree(folder)
            gone.extend(files)
        except OSError as error:
            problems.append(f"cannot remove {error.filename} ({error.strerror}); make it removable, then prune again")

    outputs, sweeps, dry_run = options.outputs, options.sweeps, options.dry_run
    list_folders(outputs)  # says so where it cannot be read
    all_runs = _find_units(runs_folder(outputs), of_jobs=False)
    all_sweeps = _find_units(sweeps_folder(outputs), of_jobs=True)
    reasons = _find_reasons(all_runs, options.keep)
    if sweeps is None:
        reasons |= {each.folder: "sweeps stay without --sweeps" for each in all_sweeps}
    else:
        reasons |= _find_reasons(all_sweeps, sweeps)
    _add_needed([*all_runs, *all_sweeps], reasons)
    gone: list[os.stat_result] = []
    problems, removed = [], 0
    for leftover in [*runs_folder(outputs).glob(f"{HIDDEN}*"), *sweeps_folder(outputs).glob(f"{HIDDEN}*")]:
        files = _list_files(leftover)
        say(f"remove  {leftover}  {_size(files)}, left by a prune that was stopped", console)
        remove(leftover, files)
    for unit in [*all_runs, *(all_sweeps if sweeps is not None else [])]:
        if unit.folder in reasons:
            say(f"keep    {unit.folder}  {reasons[unit.folder]}", console)
            continue
        files = _list_files(unit.folder)
        try:
            hidden = unit.folder if dry_run else _hide(unit)
        except Timeout:
            say(f"keep    {unit.folder}  is at work since a moment ago", console)
            continue
        except OSError as error:
            say(f"keep    {unit.folder}  cannot be removed", console)
            problems.append(f"cannot remove {unit.folder} ({error.strerror}); make {unit.folder.parent} writable")
            continue
        say(f"remove  {unit.folder}  {_size(files)}", console)
        removed += 1
        remove(hidden, files)
    links = Counter((each.st_dev, each.st_ino) for each in gone)
    found = {(each.st_dev, each.st_ino): each for each in reversed(gone)}  # as it was before the first link went
    left = [each for key, each in found.items() if each.st_nlink > links[key]]
    freed = [each for key, each in found.items() if each.st_nlink <= links[key]]
    shared = f"; {_size(left)} more stay, as folders that are kept have them too" if left else ""
    would = "would be " if dry_run else ""
    say(f"{format_count(removed, 'folder')} {would}removed, {_size(freed)} {would}freed{shared}", console)
    if dry_run:
        say("nothing was changed (--dry-run)", console)
    for each in problems:
        complain(each)
    return 1 if problems else 0


def _list_files(folder: Path) -> list[os.stat_result]:
    """Return what is known of each file in a folder, however deep; links are themselves."""
    return [each.lstat() for each in folder.rglob("*") if each.is_symlink() or not each.is_dir()]


def _size(files: Iterable[os.stat_result]) -> str:
    """Return the bytes of files, each once, as a person reads them."""
    return decimal(sum({(each.st_dev, each.st_ino): each.st_size for each in files}.values()), precision=2)


def _find_units(folder: Path, of_jobs: bool) -> list[Unit]:
    """Return the runs or sweeps in a folder, the newest first."""
    units = []
    for each in sorted(list_within(folder)):
        runs = sorted(list_within(each)) if of_jobs else [each]
        units.append(Unit(each, runs, [ledger for run in runs if (ledger := Ledger.look(run))]))
    return sorted(units, key=lambda unit: max((each.age[0] for each in unit.ledgers), default=0), reverse=True)


def _find_reasons(units: Sequence[Unit], count: int) -> dict[Path, str]:
    """Return why units stay that no other one needs."""
    newest = [each for each in units if each.ledgers][:count]
    told = f"is among the newest {count}" if count > 1 else "is the newest"
    reasons = {each.folder: _protect(each) or (told if each in newest else "") for each in units}
    return {folder: reason for folder, reason in reasons.items() if reason}


def _protect(unit: Unit) -> str | None:
    """Return why a unit stays however old it is, or None."""
    if unit.folder.is_symlink():
        return "is a link to elsewhere; remove it by hand"
    if not unit.ledgers or len(unit.ledgers) < len(unit.runs):
        return "has no run.json that can be read; look at it, and remove it by hand"
    if any(live_status(each) == "running" for each in unit.ledgers) or is_launched(unit.folder):
        return "is at work"
    if any(each.status == "paused" for each in unit.ledgers):
        return "is paused, and waits for a person"
    measured = (_describe_measured(*each) for ledger in unit.ledgers for each in ledger.records.items())
    return next((each for each in measured if each), None)


def _describe_measured(stage: str, record: Mapping[str, Any]) -> str | None:
    """Return that a stage was measured on real hardware, or may have been, or None."""
    real = record.get("measured")
    if real is None:  # a ledger of an earlier version
        sections = [each for each in record["config"].values() if isinstance(each, dict)]
        for target in [each["_target_"] for each in sections if isinstance(each.get("_target_"), str)]:
            found = _is_real(target)
            if found is None:
                return f"may hold what {stage} measured: {target} cannot be asked whether it is real hardware"
            real = real or found
    return f"holds what {stage} measured on real hardware" if real else None


@cache
def _is_real(target: str) -> bool | None:
    try:
        return getattr(find_target(target), "real", False) is not False
    except Exception:  # whatever an import of what is gone, or fits no more, raises
        return None


def _add_needed(units: Sequence[Unit], reasons: dict[Path, str]) -> None:
    """Add to the units that stay those whose files their configurations name, and what those name in turn."""
    others = [each for each in units if each.folder not in reasons]
    places = {place(each.folder): each.folder for each in others for place in (os.path.abspath, os.path.realpath)}
    ends = {(each.folder.parent.name, each.folder.name): each.folder for each in others}
    waiting = [each for each in units if each.folder in reasons]
    while waiting and len(reasons) < len(units):
        unit = waiting.pop()
        for run in unit.runs or [unit.folder]:
            for text, folder in _find_named(run, places, ends):
                if folder not in reasons:
                    reasons[folder] = f"is needed by {run.name}, which names {text}"
                    waiting.extend(each for each in others if each.folder == folder)


def _find_named(
    run: Path, places: Mapping[str, Path], ends: Mapping[tuple[str, str], Path]
) -> Iterator[tuple[str, Path]]:
    """Yield the texts in a run's configuration that are paths into other units, also of ones that were moved since."""
    ledger = Ledger.look(run)
    facts = ledger.facts if ledger else {}
    starts = {os.getcwd(), str(facts.get("directory") or os.getcwd())}
    held = walk([facts.get("given"), read_yaml(run / "config.yaml")])
    for text in {each for _, each in held if isinstance(each, str)}:
        parts = Path(text).parts
        pairs = [*pairwise(parts), *(("runs", part) for part in parts)]
        yield from ((text, ends[pair]) for pair in pairs if pair in ends)
        for path in [Path(os.path.normpath(os.path.join(start, text))) for start in starts if text]:
            found = [str(each) for each in (path, *path.parents)] if os.path.lexists(path) else []
            yield from ((text, places[each]) for each in found if each in places)


def _hide(unit: Unit) -> Path:
    """Give a unit a name that nothing looks at; return it, or raise `Timeout` where a process works on it by now."""
    with ExitStack() as locks:
        for ledger in [each for each in unit.ledgers if (each.folder / LOCK_NAME).exists()][:MOST_LOCKS]:
            locks.enter_context(FileLock(ledger.folder / LOCK_NAME, timeout=0))
        if any(is_running(each) for each in unit.ledgers[MOST_LOCKS:]):
            raise Timeout(str(unit.folder))
        hidden = unit.folder.with_name(f"{HIDDEN}{unit.folder.name}-{os.getpid()}")
        unit.folder.rename(hidden)
        return hidden
