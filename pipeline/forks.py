"""Divides work among forked processes: each begins as a copy of this one, so that only results travel.

A fork serves work of seconds on what this process holds already; `Workers` serve long loops of jobs that can be sent.
"""

import io
import logging
import multiprocessing
import os
import pickle
import signal
import sys
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from pipeline.workers import Job, Result, begin_worker

TOKEN, MOST = 4, 16000
"""Bytes that stand for a task, and the largest number of tasks: so many fit into a pipe that nobody reads yet."""


def can_fork() -> bool:
    """Return whether this process may be forked: on Linux, where the system's libraries bear it, and not in a fork."""
    return sys.platform == "linux" and not multiprocessing.current_process().daemon


class Fork:
    """A copy of this process that does some work and sends the result; it ends with its parent, deaf to Ctrl-C.

    Objects that are `kept` are not copied on the way back: the result holds those of this process.
    """

    def __init__(self, work: Callable[[], Any], kept: Iterable[object] = ()):
        forking = multiprocessing.get_context("fork")
        self._kept = {id(each): each for each in kept}
        self._receiver, sender = forking.Pipe(duplex=False)
        self._process = forking.Process(target=self._send, args=(work, sender), daemon=True)
        self._process.start()
        sender.close()

    def is_at_work(self) -> bool:
        """Return whether the result is not there yet."""
        return self._process.is_alive() and not self._receiver.poll()

    def finish(self) -> Any:
        """Wait for the result and return it. Raises EOFError if the work failed or the process was killed."""
        try:
            sent = self._receiver.recv_bytes()
        except OSError as error:  # killed while it sent
            raise EOFError(str(error)) from error
        finally:
            self.end()
        reader = pickle.Unpickler(io.BytesIO(sent))
        reader.persistent_load = self._kept.__getitem__  # type: ignore[method-assign]
        return reader.load()

    def end(self) -> None:
        """End the process, whatever it does."""
        self._process.terminate()
        self._process.join()
        self._receiver.close()

    def _send(self, work: Callable[[], Any], sender: Connection) -> None:
        from threadpoolctl import threadpool_limits

        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        sys.stdout, sys.stderr = sys.__stdout__, sys.__stderr__  # a terminal's lock may be held by a thread left behind
        logging.disable()
        begin_worker()
        # a library's threads are not in the copy
        with threadpool_limits(1), suppress(Exception):  # a fault is met again, and told, where the work is done again
            found = work()
            sent = io.BytesIO()
            writer = pickle.Pickler(sent, pickle.HIGHEST_PROTOCOL)
            writer.persistent_id = lambda each: id(each) if id(each) in self._kept else None  # type: ignore[method-assign]
            writer.dump(found)
            sender.send_bytes(sent.getbuffer())


def divide(
    work: Callable[[Job], Result],
    tasks: Sequence[Job],
    processes: int,
    kept: Iterable[object] = (),
    begin: Callable[[int], None] = lambda place: None,
) -> list[Result]:
    """Return ``work(task)`` of independent tasks, in order, done by this process and forks of it.

    Each takes the next task when it has done one. What a fork fails at or loses is done here, so that a fault is told
    with its traceback. Results can be pickled, but for the `kept` objects that they hold. Before each task that is
    done here, `begin` is given its place, and raises if the run is to stop.
    """
    if min(processes, len(tasks)) <= 1 or len(tasks) > MOST or not can_fork():
        found: list[Result] = []
        for task in tasks:
            begin(len(found))
            found.append(work(task))
        return found
    queue, filled = os.pipe()
    os.write(filled, b"".join(place.to_bytes(TOKEN, "little") for place in range(len(tasks))))
    os.close(filled)
    done: dict[int, Result] = {}

    def take(begin: Callable[[int], None] = lambda place: None) -> None:
        while token := os.read(queue, TOKEN):
            place = int.from_bytes(token, "little")
            begin(place)
            done[place] = work(tasks[place])

    def take_while_good() -> dict[int, Result]:
        with suppress(Exception):
            take()
        return done

    forks: list[Fork] = []
    try:
        forks += [Fork(take_while_good, kept) for _ in range(min(processes, len(tasks)) - 1)]
        take(begin)
        for each in forks:
            with suppress(EOFError):
                done |= each.finish()
    finally:
        os.close(queue)
        for each in forks:
            each.end()
    return [done[place] if place in done else work(each) for place, each in enumerate(tasks)]
