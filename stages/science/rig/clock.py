"""The clock of rigs: what tells the time and lets it pass, for all that paces, supervises, stops and shows trials.

It is the computer's own; a test can put other functions in place of these, by which waiting takes no time.
"""

import threading
import time


def now_s() -> float:
    """Return the time, s, which never goes back."""
    return time.monotonic()


def sleep(for_s: float) -> None:
    """Return after a time, s; at once where none is left."""
    time.sleep(max(for_s, 0.0))


def wait(condition: threading.Condition, for_s: float | None = None) -> bool:
    """Wait as `Condition.wait` does, for a time at most, s; whoever waits holds the condition."""
    return condition.wait(for_s)
