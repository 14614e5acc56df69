"""A loop spread over processes: the same bytes as in one, and nothing lost whoever is killed."""

import math
import operator
import os
import signal
import time

import pytest

from pipeline.workers import Workers, count_cores
from tests.faults import find_parts, ledger_of, tables_of, wait_until
from tests.pipeline.conftest import CONFIG, Toy, children_of, end, success, the_only_line, wait_for_the_end_of


@pytest.fixture
def split(tmp_path):
    """The command with the toy workflow, on two processes."""
    return Toy(tmp_path / "outputs", *CONFIG, "workflow=toy", "figures=[]", "workers=2")


@pytest.mark.parametrize("workers", [1, 2])
def test_results_come_in_the_order_of_the_jobs(workers):
    pool = Workers(workers)
    assert list(pool.spread(operator.neg, range(20))) == list(range(0, -20, -1))
    assert list(pool.spread(operator.neg, [])) == []
    pool.close()
    assert 1 <= count_cores() <= (os.cpu_count() or 1)


@pytest.mark.parametrize("workers", [1, 2])
def test_what_a_job_raises_is_raised_here_after_the_results_before_it(workers):
    pool = Workers(workers)
    results = pool.spread(math.sqrt, [0, 1, 4, -1, 9, 16])
    assert [next(results) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(ValueError, match="math domain error"):
        next(results)
    assert list(pool.spread(math.sqrt, [1, 4])) == [1, 2]
    pool.close()


def test_a_loop_finds_the_workers_of_the_one_before():
    pool = Workers(2)
    before, after = ({*pool.spread(_tell_process, range(20))} for _ in range(2))
    assert before & after
    assert os.getpid() not in before
    pool.close()


def _tell_process(job):
    time.sleep(0.05)
    return os.getpid()


def test_a_fault_in_a_worker_is_told_with_its_traceback_and_mended_runs_go_on(split):
    line = the_only_line(split("doubling.fail_at=5"), 1)
    assert "doubling failed: ArithmeticError: cannot double 5" in line
    assert "in double" in (split.runs[0] / "log.txt").read_text()


def test_a_killed_worker_loses_nothing_and_the_number_of_workers_changes_no_byte(split, reference):
    line = the_only_line(split("doubling.die_at=4"), 1)
    assert "a worker process was killed" in line
    assert "workers=1" in line
    assert ledger_of(split.runs[0])["status"] == "failed"
    assert f"resuming {split.runs[0]}" in success(split, "doubling.die_at=4")
    assert tables_of(split.runs[0]) == reference
    assert "everything is fresh" in split("doubling.die_at=4", "workers=1").stdout


@pytest.mark.slow
@pytest.mark.skipif(not os.path.exists("/proc/self/stat"), reason="processes cannot be seen here")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_workers_end_with_the_run_that_started_them(split, reference, number):
    process = split.start("doubling.pause_s=0.3", anew=True)
    wait_until(process, lambda: find_parts(split))
    workers = children_of(process.pid)
    assert len(workers) >= 2
    process.send_signal(number)
    result = end(process, 30)
    wait_for_the_end_of(workers, within_s=10)
    if number == signal.SIGKILL:
        assert result.returncode == -9
    else:
        assert the_only_line(result, 128 + number).startswith("doubling interrupted: ")
    assert len(find_parts(split)) < 6
    assert f"resuming {split.runs[0]}" in success(split, "doubling.pause_s=0.3", "workers=1")
    assert tables_of(split.runs[0]) == reference
