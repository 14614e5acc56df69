"""Tasks that are shared by processes: what comes back, and what becomes of those that fail."""

import multiprocessing
import os
import signal
import sys
import time

import pytest

from stages.science.output_channels.output_channel import LONG
from stages.science.output_channels.processes import map_in_processes

OWN = os.getpid()
TASKS = list(range(12))

pytestmark = pytest.mark.skipif(
    sys.platform != "linux" or len(os.sched_getaffinity(0)) < 2, reason="needs a second core of a Linux machine"
)


def look(task: int) -> tuple[int, int]:
    time.sleep(0.02)
    return task, os.getpid()


def fail_elsewhere(task: int) -> int:
    if os.getpid() != OWN:
        raise ValueError(f"task {task} has no data")
    return look(task)[0]


def die_elsewhere(task: int) -> int:
    if os.getpid() != OWN:
        os.kill(os.getpid(), signal.SIGKILL)
    return look(task)[0]


def test_results_come_in_order_and_from_several_processes() -> None:
    found = map_in_processes(look, TASKS, LONG)
    assert [task for task, _ in found] == TASKS
    assert len({process for _, process in found}) > 1
    assert not multiprocessing.active_children()


def test_little_is_computed_in_this_process() -> None:
    assert {process for _, process in map_in_processes(look, TASKS[:2], LONG - 1)} == {OWN}


def test_an_error_elsewhere_is_raised_here() -> None:
    with pytest.raises(ValueError, match="has no data"):
        map_in_processes(fail_elsewhere, TASKS, LONG)
    assert not multiprocessing.active_children()


def test_what_a_killed_process_lacks_is_computed_here() -> None:
    assert map_in_processes(die_elsewhere, TASKS, LONG) == TASKS
