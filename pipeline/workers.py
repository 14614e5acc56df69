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


class Workers:
    """So many processes at most, which the first loop starts that is spread over them; later loops find them running.

    A loop that does not come to its end leaves none of them.
    """

    def __init__(self, count: int):
        self.count = count
        self._pool: ProcessPoolExecutor | None = None
        self._others: Sequence[BaseProcess] = ()

    def spread(
        self, function: Callable[[Job], Result], jobs: Sequence[Job], check: Callable[[], None] = lambda: None
    ) -> Iterator[Result]:
        """Yield ``function(job)`` for each of independent jobs, in order; with one worker, all is computed here.

        Function, jobs and results can be pickled. Between two results, `check` raises if the run is to stop.
        """
        if min(self.count, len(jobs)) <= 1:
            for job in jobs:
                check()
                yield function(job)
            return
        try:
            for future in [self._open().submit(function, job) for job in jobs]:
                check()
                found = future.result()
                check()
                yield found
        except BrokenProcessPool:
            self.close()
            raise PipelineError(
                "a worker process was killed, perhaps for want of memory; what was finished is kept; "
                "workers=1 needs the least memory"
            ) from None
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End the processes; parts that they have not finished are not there."""
        if self._pool is None:
            return
        processes = [each for each in multiprocessing.active_children() if each not in self._others]
        self._pool.shutdown(wait=False, cancel_futures=True)
        self._pool = None
        for process in processes:
            process.terminate()
        for process in processes:
            process.join()

    def _open(self) -> ProcessPoolExecutor:
        if self._pool is None:
            self._others = multiprocessing.active_children()
            self._pool = ProcessPoolExecutor(self.count, multiprocessing.get_context("spawn"), begin_worker)
        return self._pool


def begin_worker() -> None:
    """Begin a worker's life: deaf to Ctrl-C, which the terminal sends to all, and no longer than its parent's."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if parent := multiprocessing.parent_process():
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    wait([sentinel])
    os._exit(1)
