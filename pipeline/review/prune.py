"""Removes old runs: ``python -m pipeline.review prune --keep N``; what is at work, measured or needed stays.

The folders of runs flow in; lines that say what goes, what stays and why, and what is freed, flow out. A folder goes in
two steps, a new name that nothing looks at, then its files; so a process killed in between leaves no half of a run.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import yaml
from filelock import FileLock, Timeout
from rich.console import Console

from pipeline.config import find_target
from pipeline.launch import is_launched
from pipeline.ledger import Ledger
from pipeline.runs import LOCK_NAME, is_running, list_folders, live_status, runs_folder, sweeps_folder
from pipeline.terminal import open_console

HIDDEN = ".pruned-"
MOST_LOCKS = 200
"""Locks that are held at once; a process may open few more files."""
UNITS = ("bytes", "kB", "MB", "GB", "TB")


@dataclass
class Unit:
    """What is kept or removed as one: a run, or a sweep with all of its jobs.

    Parameters
    ----------
    folder : Path
        Its folder.
    runs : list of Path
        The folder itself, or those of a sweep's jobs.
    ledgers : list of Ledger
        Of these, as far as they can be read.
    """

    folder: Path
    runs: list[Path]
    ledgers: list[Ledger]

    @property
    def age(self) -> int:
        """Sort key: the later it began, the larger."""
        return max((each.age[0] for each in self.ledgers), default=0)


@dataclass
class Freed:
    """Files of removed folders, by device and inode: bytes, links, and how many of the links went."""

    files: dict[tuple[int, int], list[int]] = field(default_factory=dict)

    def add(self, folder: Path) -> int:
        """Count a folder's files; return their bytes."""
        seen: dict[tuple[int, int], int] = {}
        for found in _walk(folder):
            key = (found.st_dev, found.st_ino)
            seen[key] = found.st_size
            self.files.setdefault(key, [found.st_size, found.st_nlink, 0])[2] += 1
        return sum(seen.values())

    def join(self, other: Freed) -> None:
        """Count another's files too."""
        for key, (size, links, gone) in other.files.items():
            self.files.setdefault(key, [size, links, 0])[2] += gone

    @property
    def total(self) -> int:
        """Bytes of the files of which no link is left."""
        return sum(size for size, links, gone in self.files.values() if gone >= links)

    @property
    def shared(self) -> int:
        """Bytes of the files of which another folder has a link."""
        return sum(size for size, links, gone in self.files.values() if gone < links)


def prune(outputs: str, keep: int, sweeps: int | None, dry_run: bool, console: Console) -> int:
    """Remove the runs that are neither among the newest nor at work, measured or needed.

    Parameters
    ----------
    outputs : str
        The outputs folder.
    keep : int
        How many of the newest runs stay in any case.
    sweeps : int or None
        How many of the newest sweeps stay in any case; None for all.
    dry_run : bool
        Whether to say what would be done, and do nothing.
    console : Console
        For what is told.

    Returns
    -------
    int
        Exit code: 0, or 1 where a folder could not be removed.

    Raises
    ------
    PipelineError
        When the outputs folder cannot be read.
    """

    def say(text: str) -> None:
        console.print(text, soft_wrap=True, highlight=False, markup=False)

    list_folders(outputs)  # says so where it cannot be read
    runs = list(_find_units(runs_folder(outputs), of_jobs=False))
    kinds = [(runs, keep)]
    all_sweeps = list(_find_units(sweeps_folder(outputs), of_jobs=True))
    if sweeps is not None:
        kinds.append((all_sweeps, sweeps))
    reasons = {each.folder: "sweeps stay without --sweeps" for each in all_sweeps if sweeps is None}
    for units, count in kinds:
        reasons |= _say_why(units, count)
    _add_needed([*runs, *all_sweeps], reasons)
    freed, problems, removed = Freed(), [], 0
    for leftover in [
        each for folder in (runs_folder(outputs), sweeps_folder(outputs)) for each in _find_hidden(folder)
    ]:
        found = Freed()
        say(f"remove  {leftover}  {format_bytes(found.add(leftover))}, left by a prune that was stopped")
        try:
            if not dry_run:
                _delete(leftover)
            freed.join(found)
        except OSError as error:
            problems.append(f"cannot remove {error.filename} ({error.strerror}); make it removable, then prune again")
    for unit in (unit for units, _ in kinds for unit in sorted(units, key=lambda each: each.age, reverse=True)):
        if unit.folder in reasons:
            say(f"keep    {unit.folder}  {reasons[unit.folder]}")
            continue
        found = Freed()
        size = found.add(unit.folder)
        try:
            hidden = unit.folder if dry_run else _hide(unit)
        except Timeout:
            say(f"keep    {unit.folder}  is at work since a moment ago")
            continue
        except OSError as error:
            say(f"keep    {unit.folder}  cannot be removed")
            problems.append(f"cannot remove {unit.folder} ({error.strerror}); make {unit.folder.parent} writable")
            continue
        say(f"remove  {unit.folder}  {format_bytes(size)}")
        removed += 1
        try:
            if not dry_run:
                _delete(hidden)
            freed.join(found)
        except OSError as error:
            problems.append(f"cannot remove {error.filename} ({error.strerror}); make it removable, then prune again")
    told = f"{removed} {'folder' if removed == 1 else 'folders'}"
    shared = f"; {format_bytes(freed.shared)} more stay, as folders that are kept have them too" if freed.shared else ""
    would = "would be " if dry_run else ""
    say(f"{told} {would}removed, {format_bytes(freed.total)} {would}freed{shared}")
    if dry_run:
        say("nothing was changed (--dry-run)")
    for each in problems:
        open_console(stderr=True).print(each, soft_wrap=True, highlight=False, markup=False)
    return 1 if problems else 0


def format_bytes(count: int) -> str:
    """Return a number of bytes as a person reads it."""
    value, power = float(count), 0
    while value >= 999.5 and power < len(UNITS) - 1:
        value, power = value / 1000, power + 1
    return f"{count} bytes" if not power else f"{value:.3g} {UNITS[power]}"


def _find_units(folder: Path, of_jobs: bool) -> Iterator[Unit]:
    for each in _folders_within(folder):
        runs = _folders_within(each) if of_jobs else [each]
        yield Unit(each, runs, [ledger for run in runs if (ledger := Ledger.look(run))])


def _folders_within(folder: Path) -> list[Path]:
    """Return the folders in one that runs may have, links to elsewhere among them."""
    return [each for each in sorted(folder.glob("*")) if each.is_dir() and not each.name.startswith(".")]


def _find_hidden(folder: Path) -> list[Path]:
    return [each for each in sorted(folder.glob(f"{HIDDEN}*")) if each.is_dir() and not each.is_symlink()]


def _say_why(units: Sequence[Unit], count: int) -> dict[Path, str]:
    """Return why units stay that no other one needs."""
    reasons: dict[Path, str] = {}
    known = sorted((each for each in units if each.ledgers), key=lambda each: each.age, reverse=True)
    for unit in units:
        why = _protect(unit)
        if why:
            reasons[unit.folder] = why
        elif unit in known[:count]:
            reasons[unit.folder] = f"is among the newest {count}" if count > 1 else "is the newest"
    return reasons


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
    for ledger in unit.ledgers:
        for name, record in ledger.records.items():
            why = _tell_measured(name, record)
            if why:
                return why
    return None


def _tell_measured(stage: str, record: dict[str, Any]) -> str | None:
    """Return that a stage was measured on real hardware, or may have been, or None."""
    if "measured" in record:
        return f"holds what {stage} measured on real hardware" if record["measured"] else None
    sections = [each for each in record["config"].values() if isinstance(each, dict)]
    for target in [each["_target_"] for each in sections if isinstance(each.get("_target_"), str)]:
        real = _is_real(target)
        if real is None:
            return f"may hold what {stage} measured: {target} cannot be asked whether it is real hardware"
        if real:
            return f"holds what {stage} measured on real hardware"
    return None


@cache
def _is_real(target: str) -> bool | None:
    try:
        return getattr(find_target(target), "real", False) is not False
    except Exception:  # whatever an import of what is gone, or fits no more, raises
        return None


def _add_needed(units: Sequence[Unit], reasons: dict[Path, str]) -> None:
    """Add to the units that stay those whose files their configurations name, and what those name in turn."""
    others = {each.folder: each for each in units if each.folder not in reasons}
    places = {place: each for each in others.values() for place in _places_of(each.folder)}
    waiting = [each for each in units if each.folder in reasons]
    while waiting and others:
        unit = waiting.pop()
        for run in unit.runs or [unit.folder]:
            for text, folder in _find_named(run, unit, others, places):
                needed = others.pop(folder, None)
                if needed:
                    reasons[folder] = f"is needed by {run.name}, which names {text}"
                    waiting.append(needed)


def _places_of(folder: Path) -> set[str]:
    return {os.path.abspath(folder), os.path.realpath(folder)}


def _find_named(
    run: Path, unit: Unit, others: Mapping[Path, Unit], places: Mapping[str, Unit]
) -> Iterator[tuple[str, Path]]:
    """Yield the texts in a run's configuration that are paths into other units, also of ones that were moved since."""
    facts = next((each.facts for each in unit.ledgers if each.folder == run), {})
    given = [each.get("file") for each in facts.get("given", ()) if isinstance(each, dict)]
    starts = {os.getcwd(), str(facts.get("directory") or os.getcwd())}
    content = _read(run / "config.yaml")
    tokens = {*re.split(r"[/\\\s'\"]+", content), *(part for start in starts for part in Path(start).parts)}
    names = {each.name for each in others}
    texts = {*_walk_texts(given)}
    if names & tokens or any(" " in each for each in names):
        texts.update(_walk_texts(_parse(content)))
    ends = {(each.parent.name, each.name): each for each in others}
    for text in texts:
        parts = Path(text).parts
        pairs = [*pairwise(parts), *(("runs", part) for part in parts)]
        yield from ((text, ends[pair]) for pair in pairs if pair in ends)
        for start in starts:
            path = Path(os.path.normpath(os.path.join(start, text)))
            found = [str(each) for each in (path, *path.parents)] if text and os.path.lexists(path) else []
            yield from ((text, places[each].folder) for each in found if each in places)


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def _parse(content: str) -> Any:
    try:
        return yaml.load(content, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    except (yaml.YAMLError, RecursionError, ValueError):
        return content.split()


def _walk_texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for each in value.values():
            yield from _walk_texts(each)
    elif isinstance(value, list):
        for each in value:
            yield from _walk_texts(each)


def _hide(unit: Unit) -> Path:
    """Give a unit a name that nothing looks at, and return it.

    Raises
    ------
    Timeout
        When a process has begun to work on it.
    """
    locks = []
    try:
        for number, ledger in enumerate(unit.ledgers):
            if number >= MOST_LOCKS:
                if is_running(ledger):
                    raise Timeout(str(ledger.folder / LOCK_NAME))
            elif (ledger.folder / LOCK_NAME).exists():
                lock = FileLock(ledger.folder / LOCK_NAME)
                lock.acquire(timeout=0)
                locks.append(lock)
        hidden = unit.folder.with_name(f"{HIDDEN}{unit.folder.name}-{os.getpid()}")
        unit.folder.rename(hidden)
        return hidden
    finally:
        for lock in locks:
            lock.release()


def _delete(folder: Path) -> None:
    """Remove a folder with all that is in it; what links point at stays."""
    try:
        folder.chmod(0o700)
        with os.scandir(folder) as found:
            entries = list(found)
    except FileNotFoundError:
        return
    for each in entries:
        if each.is_dir(follow_symlinks=False):
            _delete(Path(each.path))
        else:
            Path(each.path).unlink(missing_ok=True)
    try:
        folder.rmdir()
    except FileNotFoundError:
        return


def _walk(folder: Path) -> Iterator[os.stat_result]:
    """Yield what is known of each file in a folder, however deep; links are themselves."""
    try:
        with os.scandir(folder) as found:
            entries = list(found)
    except OSError:
        return
    for each in entries:
        if each.is_dir(follow_symlinks=False):
            yield from _walk(Path(each.path))
        else:
            yield each.stat(follow_symlinks=False)
