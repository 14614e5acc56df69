"""The folders of runs: find them, claim one.

A study's identity flows in; out flows a folder that this process alone may write, held by a lease that ends when the
process dies, however it dies. A run lies in ``runs/STAMP``, a job of a sweep in ``sweeps/NAME/JOB``.
"""

import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import datetime
from functools import partial
from itertools import count
from pathlib import Path
from typing import NamedTuple

from pipeline.command import command_line
from pipeline.errors import ConfigError, PipelineError, TakenError, suggest
from pipeline.files import clear_temporaries
from pipeline.lease import Lease
from pipeline.ledger import FILE_NAME, Ledger

LOCK_NAME = ".lock"
MAKING = ".making"
MOST_NAMED = 5
"""Runs that a message names where a name means many."""
SOONEST_S, LATEST_S = 0.05, 1.0
"""Between two looks whether another process is done with a stage, s: ever more seldom."""


class Claim(NamedTuple):
    """A run that this process may write, whether it was begun before, and the lease held until this context ends."""

    ledger: Ledger
    resumed: bool
    lease: Lease


def runs_folder(outputs: str | Path) -> Path:
    """Return the folder that holds one folder per run."""
    return Path(outputs) / "runs"


def sweeps_folder(outputs: str | Path) -> Path:
    """Return the folder that holds one folder per sweep."""
    return Path(outputs) / "sweeps"


def list_folders(outputs: str | Path) -> list[Path]:
    """Return the folders of all runs, and of all jobs of all sweeps."""
    runs = list_within(runs_folder(outputs))
    return [*runs, *(job for sweep in list_within(sweeps_folder(outputs)) for job in list_within(sweep))]


def list_within(folder: Path) -> list[Path]:
    """Return the folders in a folder but for hidden ones; none where it is not there."""
    try:
        with os.scandir(folder) as found:
            return [Path(each.path) for each in found if each.is_dir() and not each.name.startswith(".")]
    except FileNotFoundError:
        return []
    except OSError as error:
        told = f"cannot read {folder} ({error.strerror or error}); expected a folder; choose another with outputs=PATH"
        raise PipelineError(told) from None


def list_ledgers(outputs: str | Path) -> list[Ledger]:
    """Return the ledgers of all runs that have a readable one, newest first."""
    found = [Ledger.look(each) for each in list_folders(outputs)]
    return sorted((each for each in found if each), key=lambda each: each.age, reverse=True)


def find_run(outputs: str | Path, name: str) -> Ledger:
    """Return the run of a given name, unique beginning of a name, or ``latest``."""
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
        some = ", ".join(names[:MOST_NAMED]) + (", ..." if len(names) > MOST_NAMED else "")
        raise ConfigError(f"'{name}' begins the names of {len(matching)} runs ({some}); type more of it")
    raise ConfigError(f"no run '{name}' in {runs_folder(outputs)}; {suggest(name, [*names, 'latest'])}")


def is_running(ledger: Ledger) -> bool:
    """Return whether a living process holds the run, on this machine or another."""
    return Lease(ledger.folder / LOCK_NAME).is_held()


def _hold(folder: Path) -> Lease | None:
    """Return the lease of a run, now held by this process, or None where another one holds it."""
    lost = partial(os.kill, os.getpid(), signal.SIGTERM)  # a machine that had not heard of this one took the run over
    lease = Lease(folder / LOCK_NAME, lost)
    return lease if lease.take() else None


def live_status(ledger: Ledger) -> str:
    """Return a run's status, telling a run whose process died from one that runs."""
    return "killed" if ledger.status == "running" and not is_running(ledger) else ledger.status


def describe_status(folder: Path, ledger: Ledger | None, empty: str = "no ledger") -> str:
    """Return the status of a run or, where its ledger cannot be read, why; `empty` where there is none."""
    if ledger is not None:
        return live_status(ledger)
    return "unreadable" if not os.access(folder, os.X_OK) or (folder / FILE_NAME).exists() else empty


@contextmanager
def claim(outputs: str | Path, identity: str, arguments: Sequence[str], place: Path | None = None) -> Iterator[Claim]:
    """Claim the newest unfinished run of this study that nobody holds, or make a new one, or claim a given `place`.

    A PipelineError says that the folder cannot be written, or that another process holds it.
    """
    try:
        if place is not None:
            held = _take(place, identity, list(arguments), _next_sequence(outputs))
        else:
            held = _resume(outputs, identity) or _create(outputs, identity, list(arguments))
    except OSError as error:
        raise PipelineError(
            f"cannot write to {error.filename or runs_folder(outputs)} ({error.strerror or error}); "
            "free the folder or choose another with outputs=PATH"
        ) from None
    try:
        yield held
    finally:
        held.lease.release()


@contextmanager
def make_exclusively(
    outputs: str | Path, fingerprint: str, check: Callable[[], None], tell: Callable[[], None]
) -> Iterator[None]:
    """Wait until no other process makes the same, and let none begin it meanwhile.

    Few locks serve all fingerprints: who waits for another's is late, no worse. `check` raises if the run is to stop;
    `tell` is called once if there is something to wait for.
    """
    folder = Path(outputs) / MAKING / fingerprint[:3]
    folder.mkdir(parents=True, exist_ok=True)
    lease = Lease(folder / LOCK_NAME)
    if not lease.take():
        tell()
        look_s = SOONEST_S
        while not lease.take():
            check()
            time.sleep(look_s)
            look_s = min(1.2 * look_s, LATEST_S)
    try:
        yield
    finally:
        lease.release()


def _take(place: Path, identity: str, arguments: list[str], sequence: int) -> Claim:
    place.mkdir(parents=True, exist_ok=True)
    lease = _hold(place)
    if lease is None:
        raise TakenError(f"{place}: another process has this job at work; wait for it, or stop it")
    begun = Ledger.begin(place, identity, sequence, arguments)
    before = Ledger.read(place)
    if before is None:
        return Claim(begun, False, lease)
    clear_temporaries(place)
    begun.facts["stages"] = before.facts["stages"]
    begun.facts["seconds"] = before.facts.get("seconds", 0.0) if before.status != "done" else 0.0
    return Claim(begun, before.facts["identity"] == identity and before.status != "done", lease)


def _next_sequence(outputs: str | Path) -> int:
    """Return a number above those of all runs; of two that begin at once, names tell which is the newer."""
    return max((each.age[0] for each in list_ledgers(outputs)), default=0) + 1


def _resume(outputs: str | Path, identity: str) -> Claim | None:
    for ledger in list_ledgers(outputs):
        if ledger.facts["identity"] != identity or ledger.status == "done":
            continue
        lease = _hold(ledger.folder)
        if lease is None:
            continue
        current = Ledger.read(ledger.folder)
        if current is None or current.status == "done":
            lease.release()
            continue
        clear_temporaries(current.folder)
        current.facts.update(status="running", ended=None, error=None)
        current.since_s = time.monotonic()
        return Claim(current, True, lease)
    return None


def _create(outputs: str | Path, identity: str, arguments: list[str]) -> Claim:
    folder = runs_folder(outputs)
    folder.mkdir(parents=True, exist_ok=True)
    stamp = datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
    sequence = _next_sequence(outputs)
    for attempt in count(1):
        place = folder / (stamp if attempt == 1 else f"{stamp}-{attempt}")
        with suppress(FileExistsError):
            place.mkdir()
            break
    return _take(place, identity, arguments, sequence)
