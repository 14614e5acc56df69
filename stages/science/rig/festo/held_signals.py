"""Ctrl-C, SIGTERM and a closed terminal while muscles are under pressure: acted upon once the muscles are let down.

A signal flows in; its name flows out to whoever asks, and at the end the signal itself, to whom it was for.
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

NAMES = {signal.SIGINT: "Ctrl-C", signal.SIGTERM: "SIGTERM"}
if hasattr(signal, "SIGHUP"):
    NAMES[signal.SIGHUP] = "SIGHUP (the terminal was closed)"


@dataclass
class Held:
    """The signal that arrived, if one did."""

    number: int | None = None

    def note(self, number: int, _: FrameType | None) -> None:
        """Note the first one."""
        self.number = self.number or number

    @property
    def name(self) -> str | None:
        """What it is called."""
        return None if self.number is None else NAMES[signal.Signals(self.number)]


@contextmanager
def hold_signals() -> Iterator[Held]:
    """Hold these signals back, but those that are ignored; outside the main thread, where none arrives, do nothing."""
    held = Held()
    if threading.current_thread() is not threading.main_thread():
        yield held
        return
    heard = [number for number in NAMES if signal.getsignal(number) is not signal.SIG_IGN]
    before = {number: signal.signal(number, held.note) for number in heard}
    try:
        yield held
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if held.number is not None:
            signal.raise_signal(held.number)
