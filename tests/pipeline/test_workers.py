"""A loop spread over processes: the same bytes as in one, and nothing lost whoever is killed."""

import math
import operator
import os
import signal

import pytest

from pipeline.workers import count_cores, spread
from tests.conftest import Command
from tests.faults import find_parts, ledger_of, tables_of, wait_until
from tests.pipeline.conftest import CONFIG, children_of, end, the_only_line, wait_for_the_end_of

SPREAD = (*CONFIG, "workflow=spread", "squaring.count=8", "figures=[]")


@pytest.fixture
def split(tmp_path):
    """The command with the spread workflow, on two processes."""
    return Command(tmp_path / "outputs", *SPREAD, "workers=2")


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """The tables of a run in one process."""
    alone = Command(tmp_path_factory.mktemp("reference") / "outputs", *SPREAD, "workers=1")
    assert alone().returncode == 0
    return tables_of(alone.runs[0])


@pytest.mark.parametrize("workers", [1, 2])
def test_results_come_in_the_order_of_the_jobs(workers):
    assert list(spread(operator.neg, range(20), workers)) == list(range(0, -20, -1))
    assert list(spread(operator.neg, [], workers)) == []


@pytest.mark.parametrize("workers", [1, 2])
def test_what_a_job_raises_is_raised_here_after_the_results_before_it(workers):
    results = spread(math.sqrt, [0, 1, 4, -1, 9, 16], workers)
    assert [next(results) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(ValueError, match="math domain error"):
        next(results)


def test_counts_the_cores_that_may_be_used():
    assert 1 <= count_cores() <= (os.cpu_count() or 1)


def test_a_fault_in_a_worker_is_told_with_its_traceback_and_mended_runs_go_on(split):
    line = the_only_line(split("squaring.fail_at=5"), 1)
    assert "squaring failed: ArithmeticError: cannot square 5" in line
    assert "in square" in (split.runs[0] / "log.txt").read_text()


def test_a_killed_worker_loses_nothing_and_the_number_of_workers_changes_no_byte(split, reference):
    line = the_only_line(split("squaring.die_at=4"), 1)
    assert "a worker process was killed" in line
    assert "workers=1" in line
    assert ledger_of(split.runs[0])["status"] == "failed"
    again = split("squaring.die_at=4")
    assert again.returncode == 0, again.stderr
    assert f"resuming {split.runs[0]}" in again.stdout
    assert tables_of(split.runs[0]) == reference
    assert "everything is fresh" in split("squaring.die_at=4", "workers=1").stdout


@pytest.mark.slow
@pytest.mark.skipif(not os.path.exists("/proc/self/stat"), reason="processes cannot be seen here")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_workers_end_with_the_run_that_started_them(split, reference, number):
    slowly = "squaring.pause_s=0.3"
    process = split.start(slowly, anew=True)
    wait_until(process, lambda: find_parts(split, "squaring"))
    workers = children_of(process.pid)
    assert len(workers) >= 2
    process.send_signal(number)
    result = end(process, 30)
    wait_for_the_end_of(workers)
    if number == signal.SIGKILL:
        assert result.returncode == -9
    else:
        assert the_only_line(result, 128 + number).startswith("squaring interrupted: ")
    landed = len(find_parts(split, "squaring"))
    assert landed < 8
    again = split(slowly, "workers=1")
    assert again.returncode == 0, again.stderr
    assert f"resuming {split.runs[0]}" in again.stdout
    assert tables_of(split.runs[0]) == reference
