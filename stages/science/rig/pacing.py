"""A loop at a fixed rate.

Ticks flow out when they are due, with how late they are; those that were slept through are skipped, so that what
follows keeps to the trial's time.
"""

import gc
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import pandas as pd

from stages.science.rig import clock


@dataclass(frozen=True)
class Tick:
    """One turn of the loop."""

    index: int
    """Its number; numbers that are left out were missed."""
    due_s: float
    """When it was to begin, by the monotonic clock, s."""

    @property
    def late_s(self) -> float:
        """How much later than due it is now, s."""
        return clock.now_s() - self.due_s


def pace(count: int, period_s: float) -> Iterator[Tick]:
    """Yield ticks as they are due, every so many seconds: the first at once, the last of a count always."""
    begun, index = clock.now_s(), 0
    while index < count:
        clock.sleep(begun + index * period_s - clock.now_s())
        late_s = clock.now_s() - begun - index * period_s
        index += min(int(late_s / period_s), count - 1 - index)
        yield Tick(index, begun + index * period_s)
        index += 1


@contextmanager
def undisturbed() -> Iterator[None]:
    """Put the collection of garbage off, which would stop a loop for many periods."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


@dataclass(frozen=True)
class Pace:
    """How a loop kept its rate.

    Of the samples that were due: median and 99th percentile of the time from one to the next, s, and how many overran,
    that is, were missed or taken more than half a period late.
    """

    samples: int
    p50_s: float
    p99_s: float
    overruns: int

    def __str__(self) -> str:
        share = 100.0 * self.overruns / self.samples
        return (
            f"period p50 {1e3 * self.p50_s:.2f} ms, p99 {1e3 * self.p99_s:.2f} ms, "
            f"{self.overruns} of {self.samples} samples overrun ({share:.2f} %)"
        )


def measure_pace(recordings: pd.DataFrame, by: Sequence[str]) -> Pace:
    """Return how a loop kept its rate over trials, which columns tell apart, none for one trial.

    Of the recordings count muscle, time_s, late_s and status.
    """
    rows = recordings[recordings["muscle"] == recordings["muscle"].iloc[0]]
    trials = [rows] if not by else [its for _, its in rows.groupby(list(by), sort=False)]
    periods, overruns = [], 0
    for its in trials:
        time_s, late_s = its["time_s"].to_numpy(), its["late_s"].to_numpy()
        taken = its["status"].to_numpy() != "missed"
        periods.append(np.diff((time_s + late_s)[taken]))
        overruns += int((~taken | (late_s > 0.5 * (time_s[1] - time_s[0]))).sum())
    p50_s, p99_s = np.percentile(np.concatenate(periods), [50.0, 99.0])
    return Pace(len(rows), float(p50_s), float(p99_s), overruns)
