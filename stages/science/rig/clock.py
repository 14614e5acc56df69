"""The clock of rigs: what tells the time and lets it pass, for all that paces, supervises, stops and shows trials.

It is the computer's own; a test can put another in its place, which passes as quickly as whoever waits for it sleeps.
"""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager


class Clock:
    """The computer's clock, as of ``time.monotonic``."""

    def now_s(self) -> float:
        """Return the time, s, which never goes back."""
        return time.monotonic()

    def sleep(self, for_s: float) -> None:
        """Return after a time, s."""
        time.sleep(for_s)

    def wait(self, condition: threading.Condition, for_s: float | None) -> bool:
        """Wait as `Condition.wait` does; whoever waits holds the condition."""
        return condition.wait(for_s)


_current = Clock()


def now_s() -> float:
    """Return the time by the current clock, s."""
    return _current.now_s()


def sleep(for_s: float) -> None:
    """Return after a time of the current clock, s; at once where none is left."""
    _current.sleep(max(for_s, 0.0))


def wait(condition: threading.Condition, for_s: float | None = None) -> bool:
    """Wait as `Condition.wait` does, for a time of the current clock at most, s."""
    return _current.wait(condition, for_s)


@contextmanager
def go_by(clock: Clock) -> Iterator[None]:
    """Have another clock be the current one, for all threads of this process."""
    global _current
    before, _current = _current, clock
    try:
        yield
    finally:
        _current = before
