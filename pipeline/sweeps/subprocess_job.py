"""A function run in a process of its own, forked off this one: whatever becomes of it is told, and no more is lost.

A function flows in; out flows how it ended: its exit code or the signal that killed it, the most memory it held, and
the end of what it printed. All that this process has imported is there already, so a fork costs milliseconds.
"""

import ctypes
import os
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import NoReturn

from pipeline.files import read_end
from pipeline.ledger import to_mb

SOONEST_S, LATEST_S = 0.002, 0.05
"""Between two looks at the process, s: short at first, so that a short one costs little."""
ASK_S = 0.5
"""Between two questions whether a process is to stop, s: the answer may lie on another machine."""
QUOTED = 4000
"""Bytes of what it printed of which the end is kept."""
SET_PARENT_DEATH_SIGNAL = 1
"""Of Linux's prctl."""


@dataclass(frozen=True)
class Ending:
    """How a process ended: its exit code, or the signal that killed it, whose number and 128 are the code then.

    Further, the seconds from its start, its largest resident set in MB, and the end of what it printed.
    """

    code: int
    signal: int | None
    seconds: float
    peak_memory_mb: float
    output: str


def run_in_subprocess(work: Callable[[], int], wants_stop: Callable[[], bool]) -> Ending:
    """Run a function, which returns an exit code, in a process of its own, which ends when this one does.

    `wants_stop` is asked from time to time; once true, the process is sent SIGTERM.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    begun = time.monotonic()
    with tempfile.TemporaryFile() as printed:
        own = os.getpid()
        child = os.fork()
        if child == 0:
            _run_child(work, printed.fileno(), own)
        wait_s, asked, next_s = SOONEST_S, False, begun
        while True:
            pid, status, usage = os.wait4(child, os.WNOHANG)
            if pid:
                break
            if not asked and time.monotonic() >= next_s:
                next_s = time.monotonic() + ASK_S
                if wants_stop():
                    os.kill(child, signal.SIGTERM)
                    asked = True
            time.sleep(wait_s)
            wait_s = min(1.2 * wait_s, LATEST_S)
        seconds = time.monotonic() - begun
        output = read_end(printed, QUOTED)
    killed = os.WTERMSIG(status) if os.WIFSIGNALED(status) else None
    code = 128 + killed if killed else os.waitstatus_to_exitcode(status)
    return Ending(code, killed, round(seconds, 3), to_mb(usage.ru_maxrss), output)


@cache
def end_with_parent(pid: int) -> None:
    """Have this process, of this number, end when its parent does, also while it waits for a job."""
    parent = os.getppid()

    def follow() -> None:
        while os.getppid() == parent:
            time.sleep(ASK_S)
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


def _run_child(work: Callable[[], int], printed: int, parent: int) -> NoReturn:
    code = 1
    try:
        if sys.platform == "linux":  # at once, whatever this process does
            ctypes.CDLL(None, use_errno=True).prctl(SET_PARENT_DEATH_SIGNAL, signal.SIGKILL)
        else:
            end_with_parent(os.getpid())
        if os.getppid() != parent:
            os._exit(1)
        os.dup2(printed, 1)
        os.dup2(printed, 2)
        code = work()
        sys.stdout.flush()
        sys.stderr.flush()
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(code)
