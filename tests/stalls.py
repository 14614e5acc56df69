"""Real time, as far as the machine gives it: a test that fails while the machine stood still is tried again.

A process on each core wakes every few milliseconds and remembers by how much it overslept. A test in real time that
fails although neither overslept has failed. One that fails while they did, which says nothing of what it tests, runs
again in a while; when each of its tries met a standstill it is skipped, with what it met as the reason. Where the idle
machine stands still all the time, as a guest that its host starves, none of these tests is run, and each says so.
"""

import ctypes
import multiprocessing
import os
import time
from multiprocessing.process import BaseProcess
from multiprocessing.sharedctypes import Synchronized

import pytest

BEAT_S = 0.004
STALL_S = 0.02
"""Two samples at 100 Hz: what they are late by, commands and clocks show."""
TRIES = 4
RETRIES = 25
"""Of all tests together, so that a machine that never has the time tells so within minutes."""
CALM_S = 4.0
REST_S = 6
HOPELESS_S, HOPELESS = 0.1, 0.4
"""Standstill of a machine at rest by which trials are broken off, and share of seconds with one that is too much."""


class StallWatch:
    """How long the cores stood still, from `begin` on."""

    def __init__(self) -> None:
        self._longest_s: list[Synchronized[float]] = []
        self._processes: list[BaseProcess] = []

    def start(self) -> None:
        """Begin to watch; the processes end with this one."""
        context = multiprocessing.get_context("spawn")
        for core in sorted(os.sched_getaffinity(0)):
            longest_s = context.Value(ctypes.c_double, 0.0)
            self._longest_s.append(longest_s)
            self._processes.append(context.Process(target=_beat, args=(core, longest_s), daemon=True))
            self._processes[-1].start()

    def close(self) -> None:
        """End the processes, if there are any."""
        for process in self._processes:
            process.kill()
            process.join()

    @property
    def pids(self) -> list[int]:
        """Of the processes, one for each core."""
        return [process.pid for process in self._processes]

    def begin(self) -> None:
        """Forget what was."""
        for longest_s in self._longest_s:
            longest_s.value = 0.0

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


def is_hopeless(watch: StallWatch, rest_s: int) -> bool:
    """Return whether a core stands still again and again while nothing is to be done."""
    stalled = 0
    for _ in range(rest_s):
        watch.begin()
        time.sleep(1.0)
        stalled += watch.longest_s() >= HOPELESS_S
    return stalled >= HOPELESS * rest_s


class RealTime:
    """Plugin of pytest's: judges tests that are marked ``realtime`` by the time that the machine gave them."""

    def __init__(
        self,
        watch: StallWatch,
        tries: int = TRIES,
        retries: int = RETRIES,
        calm_s: float = CALM_S,
        rest_s: int = REST_S,
    ):
        self.watch = watch
        self.rest_s = rest_s
        self.tries = tries
        self.retries = retries
        self.calm_s = calm_s
        self._again = False
        self._hopeless = False

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        again = pytest.mark.flaky(reruns=self.tries - 1, reruns_delay=self.calm_s, condition=lambda: self._again)
        for item in items:
            if item.get_closest_marker("realtime"):
                item.add_marker(again)

    def pytest_collection_finish(self, session: pytest.Session) -> None:
        if any(item.get_closest_marker("realtime") for item in session.items) and not session.config.option.collectonly:
            self.watch.start()
            self._hopeless = is_hopeless(self.watch, self.rest_s)

    def pytest_unconfigure(self) -> None:
        self.watch.close()

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> None:
        if item.get_closest_marker("realtime"):
            if self._hopeless:
                pytest.skip(f"not judged: this machine, at rest, stood still for {1000 * HOPELESS_S:.0f} ms and more")
            self.watch.begin()

    @pytest.hookimpl(wrapper=True, trylast=True)
    def pytest_runtest_makereport(self, item: pytest.Item):
        report = yield
        if report.failed and item.get_closest_marker("realtime"):
            stall_s = self.watch.longest_s()
            stalled = stall_s >= STALL_S
            self._again = stalled and item.execution_count < self.tries and self.retries > 0
            self.retries -= self._again
            if stalled and not self._again:
                path, line, _ = item.location
                reason = f"not judged: the machine stood still for {1000 * stall_s:.0f} ms while it failed"
                report.outcome, report.longrepr = "skipped", (path, (line or 0) + 1, reason)
        return report
