"""The folder of runs: find them, claim one.

A study's identity flows in; out flows a folder that this process alone may write, held by a lock that the system
releases when the process dies, however it dies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from filelock import FileLock, Timeout

from pipeline.command import command_line
from pipeline.errors import ConfigError, PipelineError, suggest
from pipeline.files import clear_temporaries
from pipeline.ledger import Ledger

LOCK_NAME = ".lock"


@dataclass(frozen=True)
class Claim:
    """A run that this process may write.

    Parameters
    ----------
    ledger : Ledger
        Of the claimed run.
    resumed : bool
        Whether an earlier process began it.
    lock : FileLock
        Held until released.
    """

    ledger: Ledger
    resumed: bool
    lock: FileLock


def runs_folder(outputs: str | Path) -> Path:
    """Return the folder that holds one folder per run."""
    return Path(outputs) / "runs"


def list_folders(outputs: str | Path) -> list[Path]:
    """Return the folders of all runs.

    Raises
    ------
    PipelineError
        When there is a folder of runs that cannot be read.
    """
    folder = runs_folder(outputs)
    try:
        return [each for each in folder.iterdir() if each.is_dir()]
    except FileNotFoundError:
        return []
    except OSError as error:
        raise PipelineError(
            f"cannot read {folder} ({error.strerror or error}); expected a folder; choose another with outputs=PATH"
        ) from None


def list_ledgers(outputs: str | Path) -> list[Ledger]:
    """Return the ledgers of all runs that have a readable one, newest first."""
    found = [Ledger.read(each) for each in list_folders(outputs)]
    return sorted((each for each in found if each), key=lambda each: each.age, reverse=True)


def find_run(outputs: str | Path, name: str) -> Ledger:
    """Return the run of a given name, unique beginning of a name, or ``latest``.

    Raises
    ------
    ConfigError
        When no run, or more than one, is meant.
    """
    ledgers = list_ledgers(outputs)
    if not ledgers:
        raise ConfigError(f"no runs in {runs_folder(outputs)}; make one with: {command_line([])}")
    if name == "latest":
        return ledgers[0]
    exact = [each for each in ledgers if each.name == name]
    matching = exact or [each for each in ledgers if each.name.startswith(name)]
    if len(matching) == 1:
        return matching[0]
    names = [each.name for each in matching or ledgers]
    if matching:
        raise ConfigError(f"'{name}' begins the names of {len(matching)} runs ({', '.join(names)}); type more of it")
    raise ConfigError(f"no run '{name}' in {runs_folder(outputs)}; {suggest(name, [*names, 'latest'])}")


def is_running(ledger: Ledger) -> bool:
    """Tell whether a living process holds the run."""
    if not (ledger.folder / LOCK_NAME).exists():
        return False
    lock = FileLock(ledger.folder / LOCK_NAME)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        return True
    except OSError:
        return False
    lock.release()
    return False


def claim(outputs: str | Path, identity: str, arguments: Sequence[str]) -> Claim:
    """Claim the newest unfinished run of this study that nobody holds, or make a new one.

    Parameters
    ----------
    outputs : str or Path
        The outputs folder.
    identity : str
        Of the study.
    arguments : sequence of str
        Overrides from the command line, for the ledger.

    Raises
    ------
    PipelineError
        When the folder cannot be written.
    """
    try:
        return _resume(outputs, identity) or _create(outputs, identity, list(arguments))
    except OSError as error:
        raise PipelineError(
            f"cannot write to {error.filename or runs_folder(outputs)} ({error.strerror or error}); "
            "free the folder or choose another with outputs=PATH"
        ) from None


def _resume(outputs: str | Path, identity: str) -> Claim | None:
    for ledger in list_ledgers(outputs):
        if ledger.facts["identity"] != identity or ledger.status == "done":
            continue
        lock = FileLock(ledger.folder / LOCK_NAME)
        try:
            lock.acquire(timeout=0)
        except Timeout:
            continue
        current = Ledger.read(ledger.folder)
        if current is None or current.status == "done":
            lock.release()
            continue
        clear_temporaries(current.folder)
        current.facts.update(status="running", ended=None, error=None)
        return Claim(current, True, lock)
    return None


def _create(outputs: str | Path, identity: str, arguments: list[str]) -> Claim:
    folder = runs_folder(outputs)
    folder.mkdir(parents=True, exist_ok=True)
    stamp = datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
    sequence = max((each.age[0] for each in list_ledgers(outputs)), default=0) + 1
    attempt = 1
    while True:
        place = folder / (stamp if attempt == 1 else f"{stamp}-{attempt}")
        try:
            place.mkdir()
            break
        except FileExistsError:
            attempt += 1
    lock = FileLock(place / LOCK_NAME)
    lock.acquire(timeout=0)
    return Claim(Ledger.begin(place, identity, sequence, arguments), False, lock)
