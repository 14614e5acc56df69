"""Ctrl-C and SIGTERM: noted when they arrive, told as one exception, never lost.

A signal flows in; an `Interrupted` flows out, at once where the interpreter allows it and at the next safe point where
compiled code or a callback swallowed it. While no run is claimed there is nothing to save, and the process leaves.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

WORDS = {signal.SIGINT: "Ctrl-C", signal.SIGTERM: "SIGTERM"}


class Interrupted(BaseException):
    """A signal, of this number, asked the process to stop."""

    def __init__(self, number: int):
        super().__init__(f"stopped by {WORDS[signal.Signals(number)]}")
        self.code = 128 + number


@dataclass
class Watch:
    """The signal that arrived while the watch was kept, if one did."""

    number: int | None = None
    stopping: bool = False

    def note(self, number: int, frame: FrameType | None) -> None:
        """Note the first signal and raise, unless the process is stopping already."""
        if self.number is not None:
            return
        self.number = number
        if not self.stopping:
            raise Interrupted(number)

    def check(self) -> None:
        """Raise if a signal arrived and its exception was lost on the way."""
        if self.number is not None:
            raise Interrupted(self.number)


@contextmanager
def watch() -> Iterator[Watch]:
    """Keep a watch on both signals; once one arrived, later ones change nothing."""
    kept = Watch()
    before = {number: signal.signal(number, kept.note) for number in WORDS}
    try:
        yield kept
    finally:
        if kept.number is None:
            for number, handler in before.items():
                signal.signal(number, handler)
        else:
            ignore_from_now_on()


def leave_at_once(command: str) -> None:
    """Let both signals end the process, as long as there is nothing to save, with a line to start again."""

    def leave(number: int, frame: FrameType | None) -> None:
        line = f"{Interrupted(number)} while nothing was being written; to start again, type: {command}\n"
        os.write(2, line.encode())
        os._exit(128 + number)

    for number in WORDS:
        signal.signal(number, leave)


def ignore_from_now_on() -> None:
    """Let neither signal change an exit code that is settled.

    A signal may have arrived and not reached its handler yet: it is blocked here, but a library's thread may still take
    it. The interpreter then tells on stderr that it is ignored, which is what is wanted, and nothing to tell.
    """
    tell = sys.unraisablehook
    sys.unraisablehook = lambda unraisable: None if _is_late_signal(unraisable) else tell(unraisable)
    can_block = hasattr(signal, "pthread_sigmask")
    if can_block:
        signal.pthread_sigmask(signal.SIG_BLOCK, WORDS)
    for number in WORDS:
        signal.signal(number, signal.SIG_IGN)
    if can_block:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, WORDS)
    sys.unraisablehook = tell


def _is_late_signal(unraisable: sys.UnraisableHookArgs) -> bool:
    return isinstance(unraisable.exc_value, OSError) and "ignored due to race condition" in str(unraisable.exc_value)
