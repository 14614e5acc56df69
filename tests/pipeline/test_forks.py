"""Work divided among forks of a process: complete, in order and whole, whatever becomes of the forks."""

import multiprocessing
import os
import signal
import time

import pytest

from pipeline.forks import can_fork, divide
from tests.pipeline.conftest import CONFIG, Toy, success

HERE = os.getpid()
forked = pytest.mark.skipif(not can_fork(), reason="processes are not forked on this system")


def in_a_fork():
    return os.getpid() != HERE


@pytest.mark.parametrize("processes", [1, 2, 3])
def test_results_come_in_the_order_of_the_tasks(processes):
    assert divide(lambda number: -number, range(20), processes) == list(range(0, -20, -1))
    assert divide(lambda number: -number, [], processes) == []


@forked
def test_this_process_and_its_forks_share_the_tasks_and_none_forks_again():
    def work(number):
        time.sleep(0.02)
        return os.getpid(), *divide(lambda _: os.getpid(), range(3), 2 if in_a_fork() else 1)

    found = divide(work, range(12), 2)
    assert {process for process, *_ in found} > {HERE}
    assert all({process} == {*inner} for process, *inner in found)


@forked
def test_results_hold_kept_objects_themselves_and_copies_of_others():
    kept, other = {"kept": 1}, {"other": 2}

    def work(number):
        time.sleep(0.02)
        return in_a_fork(), kept, other

    found = divide(work, range(8), 2, [kept])
    assert {away for away, *_ in found} == {True, False}
    assert all(own is kept for _, own, _ in found)
    assert all(its == other and (its is other) != away for away, _, its in found)


@pytest.mark.parametrize("processes", [1, 2])
def test_a_fault_is_raised_here_with_its_traceback(processes):
    def work(number):
        time.sleep(0.01)
        return 1.0 / (number - 5)

    with pytest.raises(ZeroDivisionError) as error:
        divide(work, range(10), processes)
    assert error.traceback[-1].name == "work"
    assert not multiprocessing.active_children()


@forked
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, None])
def test_what_a_killed_or_failing_fork_lost_is_done_here(number):
    def work(task):
        time.sleep(0.02)
        if in_a_fork() and task > 2:
            os.kill(os.getpid(), number) if number else next(iter(()))
        return task, in_a_fork()

    found = divide(work, range(10), 2)
    assert [task for task, _ in found] == list(range(10))
    assert not any(away for task, away in found if task > 2)


@pytest.mark.parametrize("processes", [1, pytest.param(2, marks=forked)])
def test_how_far_tasks_are_is_told_before_each_that_is_done_here(processes):
    begun = []
    done = divide(lambda _: (time.sleep(0.01), os.getpid())[1], range(12), processes, begin=begun.append)
    assert begun == [place for place, process in enumerate(done) if process == HERE]


@forked
def test_forks_end_with_a_run_that_is_to_stop(tmp_path):
    def work(number):
        (tmp_path / str(os.getpid())).touch()
        time.sleep(0.02 if not in_a_fork() else 60.0)

    def begin(place):
        if (tmp_path / str(HERE)).exists():
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        divide(work, range(4), 3, begin=begin)
    assert not multiprocessing.active_children()


def test_figures_and_their_order_are_the_same_wherever_they_are_drawn(tmp_path):
    drawn = []
    for workers in (1, 2):
        toy = Toy(tmp_path / str(workers), *CONFIG, "workflow=toy", "figures=[png,pdf]", f"workers={workers}")
        success(toy)
        paths = sorted((toy.runs[0] / "figures").iterdir())
        record = toy.runs[0] / "run.json"
        noted = [line.split(":")[0] for line in record.read_text().splitlines() if '"figures/' in line]
        drawn.append(([(path.name, path.read_bytes()) for path in paths], noted))
    assert drawn[0] == drawn[1]
    assert len(drawn[0][0]) >= 2
