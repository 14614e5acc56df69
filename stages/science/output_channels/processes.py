"""Independent tasks, shared by this process and copies of it: tasks flow in, their results flow out in the same order.

Threads would take turns where most of the time is spent between short calls of compiled code. A copy is forked: what
the tasks need is there already, and only what a copy found is sent back, pickled.
"""

import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection
from typing import Any

from threadpoolctl import threadpool_limits

from stages.science.output_channels.output_channel import LONG, Done, Task


def map_in_processes(work: Callable[[Task], Done], tasks: Sequence[Task], samples: int) -> list[Done]:
    """Return the results of all tasks, shared by processes where tasks have at least `LONG` samples together.

    Results can be pickled. Each process takes the next task when it is done with one, and this one takes its part. A
    process that was started by another, as a sweep's jobs are, computes all by itself.
    """
    if sys.platform != "linux" or samples < LONG or parent_process() is not None:
        return [work(each) for each in tasks]
    context = get_context("fork")
    taken = context.Value("i", 0)

    def take() -> Iterator[int]:
        while True:
            with taken.get_lock():
                place, taken.value = taken.value, taken.value + 1
            if place >= len(tasks):
                return
            yield place

    def share(receiving: Connection, sending: Connection) -> None:
        receiving.close()  # so that sending fails when the first process is gone
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the first process's, which ends this one
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        found: Any
        try:
            with threadpool_limits(1):  # OpenMP's threads are not copied
                found = {place: work(tasks[place]) for place in take()}
        except Exception as error:
            found = error
        sending.send(found)

    copies = []
    try:
        for _ in range(min(len(os.sched_getaffinity(0)), len(tasks)) - 1):
            pipe = context.Pipe(duplex=False)
            process = context.Process(target=share, args=pipe, daemon=True)
            process.start()
            pipe[1].close()
            copies.append((process, pipe[0]))
        done = {place: work(tasks[place]) for place in take()}
        for _, receiving in copies:
            found = receiving.recv()
            if isinstance(found, Exception):
                raise found
            done |= found
    finally:
        for process, receiving in copies:
            receiving.close()
            process.terminate()
            process.join()
    return [done[place] for place in range(len(tasks))]
