"""Spreads a loop over processes: jobs flow in, results flow out in the order of the jobs.

Each process is started afresh (nothing is inherited but the environment), ends with its parent, and leaves Ctrl-C to
it. What a job computes may not depend on where it is computed, so that the number of workers changes no byte.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from typing import TypeVar

from pipeline.errors import WorkerError

Job = TypeVar("Job")
Result = TypeVar("Result")


def count_cores() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def spread(
    function: Callable[[Job], Result],
    jobs: Sequence[Job],
    workers: int,
    check: Callable[[], None] = lambda: None,
) -> Iterator[Result]:
    """Yield ``function(job)`` for each job, in order.

    Parameters
    ----------
    function : callable
        Can be pickled, as can jobs and results.
    jobs : sequence
        Independent of each other.
    workers : int
        Processes; with one, or one job, all is computed here.
    check : callable
        Raises between two results if the run is to stop.
    """
    if min(workers, len(jobs)) <= 1:
        for job in jobs:
            check()
            yield function(job)
        return
    others = multiprocessing.active_children()
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(min(workers, len(jobs)), context, _prepare)
    try:
        futures = [pool.submit(function, job) for job in jobs]
        for future in futures:
            yield _wait(future, check)
        pool.shutdown()
    except BrokenProcessPool:
        raise WorkerError(
            "a worker process was killed, perhaps for want of memory; what was finished is kept; "
            "workers=1 needs the least memory"
        ) from None
    finally:
        _stop(pool, others)


def _wait(future: Future[Result], check: Callable[[], None]) -> Result:
    check()
    found = future.result()
    check()
    return found


def _prepare() -> None:
    """Begin a worker's life: deaf to Ctrl-C, which the terminal sends to all, and no longer than its parent's."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    wait([sentinel])
    os._exit(1)


def _stop(pool: ProcessPoolExecutor, others: Sequence[BaseProcess]) -> None:
    """End the processes of a pool, which are all but the others; parts that they have not finished are not there."""
    processes = [each for each in multiprocessing.active_children() if each not in others]
    pool.shutdown(wait=False, cancel_futures=True)
    for process in processes:
        process.terminate()
    for process in processes:
        process.join()
