"""A clock that is turned: time passes as soon as all who go by it rest, by as much as the first of them rests.

A thread goes by it from its first sleep on, or from `start`. Whoever is awake, in a test or in the rig, has all the
time in the world, so that nothing depends on how quick the machine is; ten seconds of sleep take none.
"""

import heapq
import itertools
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from unittest.mock import patch

import pytest

from stages.science.rig import clock

BEGINS_S = 1000.0
TURN_S = 1e-7
"""By which whoever sleeps is woken late, as by any real clock, so that rounding never wakes them early."""
GLANCE_S = 0.0005
"""Real time after which a resting thread looks whether others are awake."""
MISSED_S = 0.02
"""Real time after which who waits looks again: of a notice just as a glance ends, `Condition.wait` says nothing."""
STUCK_S = 120.0
"""Real time for which a thread may be awake while others rest, compilation included."""

Event = Callable[[], float | None]


@dataclass(eq=False)
class Rest:
    """A thread at rest: until when, s, and up to which turn one that waits for a condition saw that it was not told."""

    until_s: float
    seen: int | None = None


class TurnedClock:
    """The clock of the tests, with the functions of the rigs' own."""

    def __init__(self) -> None:
        self._now_s = BEGINS_S
        self._changed = threading.Condition()
        self._rests: dict[threading.Thread, Rest] = {}
        self._known: set[threading.Thread] = set()
        self._events: list[tuple[float, int, Event]] = []
        self._order = itertools.count()
        self._turns = 0
        self._turner: threading.Thread | None = None
        self._moved_at_s = time.monotonic()

    def now_s(self) -> float:
        return self._now_s

    def sleep(self, for_s: float) -> None:
        if for_s > 0.0:
            with self._resting(Rest(self._now_s + for_s)) as rest:
                while self._now_s <= rest.until_s:
                    self._turn()

    def wait(self, condition: threading.Condition, for_s: float | None = None) -> bool:
        """Wait as `Condition.wait`, but return whenever the clock was turned, too: who waits looks again."""
        begun_s = self._now_s
        until_s = float("inf") if for_s is None else begun_s + for_s
        again_s = time.monotonic() + MISSED_S
        with self._resting(Rest(until_s, seen=-1)) as rest:
            while self._now_s == begun_s:
                turns = self._turns
                if condition.wait(GLANCE_S) or time.monotonic() > again_s:
                    return True
                rest.seen = turns
                self._turn()
        return self._now_s <= until_s

    def start(self, *threads: threading.Thread) -> None:
        """Start threads that go by this clock from the beginning."""
        with self._changed:
            self._known |= set(threads)
        for each in threads:
            each.start()

    def join(self, *threads: threading.Thread, within_s: float = 60.0) -> None:
        end_s = self._now_s + within_s
        for each in threads:
            while each.is_alive():
                assert self._now_s < end_s, f"{each.name} did not end in time"
                self.sleep(0.01)

    def at(self, time_s: float, call: Event) -> None:
        """Have something done at a time, s, by whoever turns the clock; again so many seconds later as it returns."""
        with self._changed:
            heapq.heappush(self._events, (time_s, next(self._order), call))

    def after(self, for_s: float, call: Callable[[], object]) -> None:
        """Have something done once, so many seconds from now."""

        def once() -> None:
            call()

        self.at(self._now_s + for_s, once)

    @contextmanager
    def _resting(self, rest: Rest) -> Iterator[Rest]:
        me = threading.current_thread()
        with self._changed:
            self._known.add(me)
            before, self._rests[me] = self._rests.get(me), rest
            self._turns += 1
        try:
            yield rest
        finally:
            with self._changed:
                del self._rests[me]
                if before is not None:  # something that is done at a time slept itself
                    self._rests[me] = before

    def _turn(self) -> None:
        """Turn the clock to what is done next or to who wakes first; let real time pass if somebody is awake."""
        me = threading.current_thread()
        with self._changed:
            awake = self._find_awake()
            if awake or self._turner not in (None, me):
                assert time.monotonic() - self._moved_at_s < STUCK_S, f"awake for too long: {awake or self._turner}"
                self._changed.wait(GLANCE_S)
                return
            self._turns += 1
            self._moved_at_s = time.monotonic()
            first_s = min(rest.until_s for rest in self._rests.values())
            if not self._events or self._events[0][0] > first_s:
                self._now_s = max(self._now_s, first_s + TURN_S)
                self._changed.notify_all()
                return
            due_s, _, call = heapq.heappop(self._events)
            self._now_s = max(self._now_s, due_s)
            before, self._turner = self._turner, me
        try:
            again_s = call()
        finally:
            self._turner = before
            self._turns += 1
        if again_s is not None:
            self.at(max(self._now_s, due_s + again_s), call)

    def _find_awake(self) -> list[str]:
        """Return the threads that do not rest, were woken and do not know it yet, or have not seen the last turn."""
        self._known = {each for each in self._known if each.is_alive() or each.ident is None}
        return [each.name for each in self._known if self._is_awake(self._rests.get(each))]

    def _is_awake(self, rest: Rest | None) -> bool:
        return rest is None or rest.until_s < self._now_s or (rest.seen is not None and rest.seen != self._turns)


@contextmanager
def turn_clock() -> Iterator[TurnedClock]:
    """Have rigs go by such a clock."""
    made = TurnedClock()
    with patch.multiple(clock, now_s=made.now_s, sleep=made.sleep, wait=made.wait):
        yield made


@pytest.fixture
def turned() -> Iterator[TurnedClock]:
    """The clock that rigs go by in a test."""
    with turn_clock() as made:
        yield made
