"""Spreads a loop over processes: jobs flow in, results flow out in the order of the jobs.

Each process is started afresh (nothing is inherited but the environment), ends with its parent, and leaves Ctrl-C to
it. What a job computes may not depend on where it is computed, so that the number of workers changes no byte.
"""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from typing import TypeVar

from pipeline.errors import PipelineError

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
    """Yield ``function(job)`` for each of independent jobs, in order; with one worker, all is computed here.

    Function, jobs and results can be pickled. Between two results, `check` raises if the run is to stop.
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
            check()
            found = future.result()
            check()
            yield found
        pool.shutdown()
    except BrokenProcessPool:
        raise PipelineError(
            "a worker process was killed, perhaps for want of memory; what was finished is kept; "
            "workers=1 needs the least memory"
        ) from None
    finally:
        _stop(pool, others)


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
