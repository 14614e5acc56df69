"""Real time, as far as the machine gives it: a test that fails while the machine stood still is tried again.

A process on each core wakes every few milliseconds and remembers by how much it overslept. A test in real time that
fails although none overslept has failed. One that fails while one did, which says nothing of what it tests, runs again;
when each of its tries met a standstill it is skipped, with what it met as the reason.
"""

import ctypes
import multiprocessing
import os
import time
from multiprocessing.process import BaseProcess
from multiprocessing.sharedctypes import Synchronized

import pytest
from _pytest.runner import runtestprotocol

BEAT_S = 0.004
STALL_S = 0.02
"""Two samples at 100 Hz: what they are late by, commands and clocks show."""
TRIES = 3


class StallWatch:
    """How long the cores stood still, from `begin` on."""

    def __init__(self) -> None:
        self._longest_s: list[Synchronized[float]] = []
        self.processes: list[BaseProcess] = []

    def begin(self) -> None:
        """Forget what was, and watch from now on; the processes that do end with this one."""
        if not self.processes:
            context = multiprocessing.get_context("spawn")
            for core in sorted(os.sched_getaffinity(0)):
                self._longest_s.append(context.Value(ctypes.c_double, 0.0))
                self.processes.append(context.Process(target=_beat, args=(core, self._longest_s[-1]), daemon=True))
                self.processes[-1].start()
            while not all(longest_s.value for longest_s in self._longest_s):
                time.sleep(BEAT_S)
        for longest_s in self._longest_s:
            longest_s.value = 0.0

    def close(self) -> None:
        for process in self.processes:
            process.kill()
            process.join()

    def longest_s(self) -> float:
        """Return the longest time that a core stood still since."""
        time.sleep(2 * BEAT_S)
        return max(longest_s.value for longest_s in self._longest_s)


def _beat(core: int, longest_s: "Synchronized[float]") -> None:
    os.sched_setaffinity(0, {core})
    while True:
        due = time.monotonic() + BEAT_S
        time.sleep(BEAT_S)
        late = time.monotonic() - due
        if late > longest_s.value:
            longest_s.value = late


class RealTime:
    """Plugin of pytest's: judges tests that are marked ``realtime`` by the time that the machine gave them."""

    def __init__(self, watch: StallWatch):
        self.watch = watch

    def pytest_unconfigure(self) -> None:
        self.watch.close()

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
        if not item.get_closest_marker("realtime"):
            return None
        for _ in range(TRIES):
            self.watch.begin()
            reports = runtestprotocol(item, nextitem=nextitem, log=False)
            failed = [each for each in reports if each.failed]
            stall_s = self.watch.longest_s() if failed else 0.0
            if stall_s < STALL_S:
                break
        else:
            path, line, _ = item.location
            for each in failed:
                reason = f"not judged: the machine stood still for {1000 * stall_s:.0f} ms while it failed"
                each.outcome, each.longrepr = "skipped", (path, (line or 0) + 1, reason)
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        for each in reports:
            item.ihook.pytest_runtest_logreport(report=each)
        item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True
