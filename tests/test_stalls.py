"""Tests in real time: one that fails has failed, unless the machine stood still meanwhile."""

import os
import signal
import time

import pytest

from tests.stalls import STALL_S, StallWatch

pytest_plugins = ["pytester"]

PLUGIN = """
import pytest
from tests.stalls import STALL_S, RealTime

class Told:
    '''Standstills as a test tells them.'''
    longest = 0.0
    start = close = lambda self: None
    def begin(self):
        self.longest = {at_rest}
    def longest_s(self):
        return self.longest

WATCH = Told()

def pytest_configure(config):
    config.addinivalue_line("markers", "realtime: in real time")
    config.pluginmanager.register(RealTime(WATCH, tries=3, retries={retries}, calm_s=0.0, rest_s=1))
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
def test_stalled_once(device):
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
    assert [runs.count(each) for each in names] == [1, 1, 2, 2, {tries}, 1]
"""


@pytest.mark.parametrize(("retries", "tries", "skipped"), [(40, 3, 1), (2, 1, 1)], ids=["some left", "none left"])
def test_only_a_standstill_excuses_a_failure(pytester, retries, tries, skipped):
    pytester.makeconftest(PLUGIN.format(retries=retries, at_rest=0.0))
    pytester.makepyfile(test_it=TESTS.replace("{tries}", str(tries)))
    result = pytester.runpytest_inprocess("-rs", "-p", "no:xdist", "-p", "no:cacheprovider")
    result.assert_outcomes(passed=3, failed=3, skipped=skipped)
    result.stdout.fnmatch_lines(["*not judged: the machine stood still for 40 ms while it failed"])
    result.stdout.fnmatch_lines(["*a test of nothing in real time*"])
    result.stdout.fnmatch_lines(["*its own fault", "*its own fault, again"])


def test_a_machine_that_stands_still_at_rest_judges_nothing_in_real_time(pytester):
    pytester.makeconftest(PLUGIN.format(retries=40, at_rest=0.5))
    pytester.makepyfile(test_it=TESTS.split("def test_counts")[0])
    result = pytester.runpytest_inprocess("-rs", "-p", "no:xdist", "-p", "no:cacheprovider")
    result.assert_outcomes(failed=1, skipped=5)
    result.stdout.fnmatch_lines(["*not judged: this machine, at rest, stood still for 100 ms and more"])


def forgets(watch):
    watch.begin()
    return watch.longest_s() < 0.4


def test_a_core_that_stood_still_is_seen_and_forgotten():
    watch = StallWatch()
    watch.start()
    try:
        assert len(watch.pids) == len(os.sched_getaffinity(0))
        time.sleep(1.0)
        for pid in watch.pids:
            watch.begin()
            os.kill(pid, signal.SIGSTOP)
            time.sleep(0.5)
            os.kill(pid, signal.SIGCONT)
            assert any(watch.longest_s() > 0.4 for _ in range(500))
        assert any(forgets(watch) for _ in range(100))  # but for what this machine itself stands still
    finally:
        watch.close()
    assert STALL_S < 0.4
