"""Leases: on one machine, where the system's lock decides, and on several, where one that is not renewed is left."""

import multiprocessing
import os
import time
from unittest.mock import patch

import pytest
from filelock import FileLock

from pipeline.lease import Lease

LEASE_S, RENEW_S = 0.5, 0.1
FORK = multiprocessing.get_context("fork")


def lease_of(path, machine, lost=lambda: None):
    return Lease(path, lost, LEASE_S, RENEW_S, machine)


@pytest.fixture
def hold(tmp_path):
    """Return what starts a process that holds a path for a machine, and waits until it does."""
    begun = []

    def start(path, machine):
        ready = FORK.Event()
        process = FORK.Process(target=hold_for_ever, args=(path, machine, ready))
        process.start()
        begun.append(process)
        assert ready.wait(20)
        return process

    yield start
    for each in begun:
        each.kill()
        each.join()


def hold_for_ever(path, machine, ready):
    assert lease_of(path, machine).take()
    ready.set()
    time.sleep(60)


def kill(process):
    process.kill()
    process.join()


def test_it_is_held_until_it_is_released(tmp_path):
    path = tmp_path / ".lock"
    own, other = Lease(path), Lease(path)
    assert not own.is_held()
    for _ in range(3):
        assert own.take()
        assert not other.take()
        assert other.is_held()
        own.release()
        assert not other.is_held()
    assert other.take()
    other.release()
    assert len(list(tmp_path.iterdir())) == 3  # the lock, the newest lease, and the mark that it was given up


def test_a_killed_holder_of_this_machine_holds_no_longer(tmp_path, hold):
    process = hold(tmp_path / ".lock", "here")
    other = lease_of(tmp_path / ".lock", "here")
    assert other.is_held()
    kill(process)
    assert not other.is_held()
    assert other.take()
    other.release()


def test_a_killed_holder_of_another_machine_holds_until_its_lease_is_old(tmp_path, hold):
    process = hold(tmp_path / ".lock", "there")
    other = lease_of(tmp_path / ".lock", "here")
    time.sleep(2 * LEASE_S)
    kill(process)
    assert other.is_held()
    assert not other.take()
    time.sleep(LEASE_S + RENEW_S)
    assert not other.is_held()
    assert other.take()
    other.release()


def test_a_clock_that_is_wrong_changes_nothing(tmp_path, hold, monkeypatch):
    process = hold(tmp_path / ".lock", "there")
    kill(process)
    now = time.time
    for ahead_s in (300, -300):
        monkeypatch.setattr(time, "time", lambda ahead_s=ahead_s: now() + ahead_s)
        assert lease_of(tmp_path / ".lock", "here").is_held() is True
    time.sleep(LEASE_S + RENEW_S)
    assert lease_of(tmp_path / ".lock", "here").is_held() is False


def race(path, machine, begin, won):
    own = SeparateLock(path, lambda: None, LEASE_S, RENEW_S, machine)
    begin.wait()
    if own.take():
        won.put(machine)
        time.sleep(60)


class SeparateLock(Lease):
    """A lease of a machine on a file system that keeps its locks from others."""

    def take(self):
        with patch("filelock.FileLock", lambda path: FileLock(f"{path}-{self.machine}")):
            return super().take()


@pytest.mark.parametrize("left", [False, True], ids=["new", "left by another"])
def test_of_many_machines_that_take_it_at_once_one_has_it(tmp_path, hold, left):
    path = tmp_path / ".lock"
    if left:
        kill(hold(path, "there"))
        time.sleep(LEASE_S + RENEW_S)
    for _ in range(3):
        begin, won = FORK.Barrier(8), FORK.Queue()
        racers = [FORK.Process(target=race, args=(path, f"m{number}", begin, won)) for number in range(8)]
        for each in racers:
            each.start()
        first = won.get(timeout=20)
        time.sleep(LEASE_S)
        assert won.empty(), f"{first} and {won.get()}"
        for each in racers:
            kill(each)
        time.sleep(LEASE_S + RENEW_S)


def test_who_is_not_heard_of_is_told_when_another_took_it_over(tmp_path):
    path = tmp_path / ".lock"
    told = []
    own = SeparateLock(path, lambda: told.append(os.getpid()), LEASE_S, 2.5 * LEASE_S, "here")
    assert own.take()
    other = SeparateLock(path, lambda: None, LEASE_S, RENEW_S, "there")
    assert not other.take()
    time.sleep(1.5 * LEASE_S)
    assert other.take()
    time.sleep(2 * LEASE_S)
    assert told == [os.getpid()]
    own.release()
    assert not SeparateLock(path, lambda: None, LEASE_S, RENEW_S, "third").take()
    other.release()
