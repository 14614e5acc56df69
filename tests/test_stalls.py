"""Tests in real time: one that fails has failed, unless the machine stood still meanwhile."""

import os
import signal
import time

from tests.stalls import STALL_S, StallWatch

pytest_plugins = ["pytester"]

PLUGIN = """
from tests.stalls import STALL_S, RealTime

class Told:
    '''Standstills as a test tells them.'''
    longest = 0.0
    close = lambda self: None
    def begin(self):
        self.longest = 0.0
    def longest_s(self):
        return self.longest

WATCH = Told()

def pytest_configure(config):
    config.addinivalue_line("markers", "realtime: in real time")
    config.pluginmanager.register(RealTime(WATCH))
"""
TESTS = """
import pytest
from conftest import STALL_S, WATCH

runs = []

@pytest.fixture(scope="module")
def device():
    runs.append("device")

def test_outside():
    WATCH.longest = STALL_S
    runs.append("outside")
    raise AssertionError("a test of nothing in real time")

@pytest.mark.realtime
def test_calm(device):
    runs.append("calm")
    WATCH.longest = 0.9 * STALL_S
    raise AssertionError("its own fault")

@pytest.mark.realtime
def test_stalled_once(device, tmp_path):
    runs.append("once")
    if runs.count("once") == 1:
        WATCH.longest = 2.0 * STALL_S
        raise AssertionError("too late")

@pytest.mark.realtime
def test_fails_in_the_calm_too(device):
    runs.append("both")
    WATCH.longest = 2.0 * STALL_S if runs.count("both") == 1 else 0.0
    raise AssertionError("its own fault, again")

@pytest.mark.realtime
def test_always_stalled(device):
    runs.append("always")
    WATCH.longest = 2.0 * STALL_S
    raise AssertionError("never in time")

@pytest.mark.realtime
def test_passes_though_stalled(device):
    WATCH.longest = 2.0 * STALL_S

def test_counts():
    names = ["outside", "calm", "once", "both", "always", "device"]
    assert [runs.count(each) for each in names] == [1, 1, 2, 2, 3, 1]
"""


def test_only_a_standstill_excuses_a_failure(pytester):
    pytester.makeconftest(PLUGIN)
    pytester.makepyfile(test_it=TESTS)
    result = pytester.runpytest_inprocess("-rs", "-p", "no:xdist", "-p", "no:cacheprovider")
    result.assert_outcomes(passed=3, failed=3, skipped=1)
    result.stdout.fnmatch_lines(["*not judged: the machine stood still for 40 ms while it failed"])
    result.stdout.fnmatch_lines(["*a test of nothing in real time*"])
    result.stdout.fnmatch_lines(["*its own fault", "*its own fault, again"])


def happens(holds):
    end_s = time.monotonic() + 60.0
    while not holds() and time.monotonic() < end_s:
        pass
    return time.monotonic() < end_s


def test_a_core_that_stood_still_is_seen_and_forgotten():
    watch = StallWatch()
    try:
        watch.begin()
        assert len(watch.processes) == len(os.sched_getaffinity(0))
        for process in watch.processes:
            os.kill(process.pid, signal.SIGSTOP)
            time.sleep(0.5)
            os.kill(process.pid, signal.SIGCONT)
            assert happens(lambda: watch.longest_s() > 0.4)
            assert happens(lambda: watch.begin() or watch.longest_s() < 0.4)  # but for what this machine stands still
    finally:
        watch.close()
    assert STALL_S < 0.4
