"""Who holds a path, on this machine or on another one that shares the file system.

A path flows in; out flows whether this process alone holds it now. The system's lock ends with its process, however
that ends, and decides at once on one machine; but some file systems keep it from other machines. So a holder also has
a lease: a file beside the path, such as ``PATH.7``, that it renews. A lease of another machine holds until it has not
been renewed for `LEASE_S`. Its age is the difference of two times that the file system set, so that no clock of a
machine is ever compared with that of another.

Leases have numbers. Who takes a path makes the file of the next number, which of many only one can make; the newest is
never removed, but marked when its holder gives it up, so that no number is given twice.
"""

from __future__ import annotations

import json
import os
import platform
import threading
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING
from uuid import uuid4

if TYPE_CHECKING:
    from filelock import FileLock

RENEW_S = 10.0
"""Between two renewals of a lease, s."""
LEASE_S = 60.0
"""After which a lease of another machine that was not renewed counts as left behind, s."""
FREE = ".free"


@cache
def name_machine() -> str:
    """Return what tells this machine, as long as it runs, from all others."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:
        boot = "-"
    return f"{platform.node()} {boot}"


def name_process() -> str:
    """Return what tells this process from all others that live, also on other machines."""
    try:
        space = os.stat("/proc/self/ns/pid").st_ino
    except OSError:
        space = 0
    return f"{name_machine()} {space} {os.getpid()}"


@dataclass
class Lease:
    """A path that one process holds at a time, from `take` to `release`.

    `lost` is called in a thread if another machine took it over, having not heard of this one for `lease_s`. The
    `machine` is the name of this one.
    """

    path: Path
    lost: Callable[[], None] = lambda: None
    lease_s: float = LEASE_S
    renew_s: float = RENEW_S
    machine: str = field(default_factory=name_machine)
    _lock: FileLock | None = field(default=None, init=False)
    _file: Path | None = field(default=None, init=False)
    _number: int = field(default=0, init=False)
    _released: threading.Event = field(default_factory=threading.Event, init=False)

    def take(self) -> bool:
        """Hold the path unless another one does; return whether this one does now."""
        lock = self._acquire_lock()
        if lock is None:
            return False
        with ExitStack() as held:
            held.callback(lock.release)
            if not self._take_next():
                return False
            held.pop_all()
        self._lock = lock
        self._released.clear()
        threading.Thread(target=self._renew, name="lease", daemon=True).start()
        return True

    def release(self) -> None:
        """Let others take the path."""
        if self._lock is None or self._file is None:
            return
        self._released.set()
        with suppress(OSError):  # such as of a folder that was removed
            Path(f"{self._file}{FREE}").touch()
        self._lock.release()
        self._lock = self._file = None

    def is_held(self) -> bool:
        """Return whether a living process holds the path."""
        if not self.path.exists():
            return False
        try:
            lock = self._acquire_lock()
            if lock is None:
                return True
            try:
                return self._newest()[1]
            finally:
                lock.release()
        except OSError:
            return False

    def _acquire_lock(self) -> FileLock | None:
        """Return the system's lock of the path, now held, or None where another process holds it."""
        from filelock import FileLock, Timeout  # slow to import, and a run where all is fresh holds nothing

        lock = FileLock(self.path)
        try:
            lock.acquire(timeout=0)
        except Timeout:
            return None
        return lock

    def _take_next(self) -> bool:
        newest, held = self._newest()
        if held:
            return False
        file = self._file_of(newest + 1)
        try:
            with file.open("xb", buffering=0) as handle, suppress(OSError):  # of a full disk: then its age decides
                handle.write(json.dumps({"machine": self.machine, "pid": os.getpid()}).encode())
        except FileExistsError:
            return False
        numbers = self._numbers()
        if max(numbers.values()) > newest + 1:
            file.unlink()
            return False
        for name, number in numbers.items():
            if number <= newest:
                self.path.with_name(name).unlink(missing_ok=True)
        self._file, self._number = file, newest + 1
        return True

    def _file_of(self, number: int) -> Path:
        return self.path.with_name(f"{self.path.name}.{number}")

    def _numbers(self) -> dict[str, int]:
        """Return the number of each lease, and of each mark that one was given up, by name."""
        start = f"{self.path.name}."
        names = [each for each in os.listdir(self.path.parent) if each.startswith(start)]
        return {name: int(number) for name in names if (number := name[len(start) :].removesuffix(FREE)).isdigit()}

    def _newest(self) -> tuple[int, bool]:
        """Return the number of the newest lease, 0 without one, and whether its holder lives, its lock not seen."""
        numbers = self._numbers()
        newest = max(numbers.values(), default=0)
        file = self._file_of(newest)
        if newest == 0 or f"{file.name}{FREE}" in numbers:
            return newest, False
        try:
            with file.open(encoding="utf-8") as handle:
                renewed_s = os.fstat(handle.fileno()).st_mtime
                text = handle.read()
        except FileNotFoundError:  # taken over at this moment
            return newest, True
        with suppress(ValueError):  # not written yet
            if json.loads(text)["machine"] == self.machine:
                return newest, False
        return newest, self._now_s() - renewed_s < self.lease_s

    def _now_s(self) -> float:
        """Return the time by the clock of the file system."""
        probe = self.path.with_name(f"{self.path.name}.probe-{uuid4().hex}")
        try:
            probe.write_bytes(b"-")
            with probe.open("rb") as handle:  # an open file's times are not remembered ones
                return os.fstat(handle.fileno()).st_mtime
        finally:
            probe.unlink(missing_ok=True)

    def _renew(self) -> None:
        file = self._file
        while file is not None and not self._released.wait(self.renew_s):
            with suppress(OSError):  # of a server that is away for a while, or a folder that was removed
                if max(self._numbers().values(), default=0) > self._number:
                    self.lost()
                    return
                with file.open("r+b") as handle:
                    handle.write(b"{")  # as it is: the file system notes the time
