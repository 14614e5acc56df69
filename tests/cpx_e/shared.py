"""Memory that the server and the plant's process share.

Commanded pressures and faults of valves and joints flow from server to plant, counts of sensors from plant to server.
Counts are written into two places in turn, so that a reader never sees half of a sample.
"""

from __future__ import annotations

import mmap

import numpy as np

REMEMBERED = 256
"""Commands that are remembered, so that a plant that is late still knows when each was written."""


class Shared:
    """Arrays in anonymous memory, to be made before the fork.

    Parameters
    ----------
    muscles, joints : int
        How many there are.
    """

    def __init__(self, muscles: int, joints: int):
        sensors = 2 * muscles + joints
        sizes = {
            "commands": REMEMBERED * (1 + muscles),
            "ordered": 1,
            "valve_kpa": muscles,
            "run_rad_per_s": joints,
            "counts": 2 * sensors,
            "ticks": 1,
            "written_s": 1,
            "costs_s": 3,
        }
        memory = mmap.mmap(-1, 8 * sum(sizes.values()))
        whole = np.frombuffer(memory, dtype=float)
        places = np.split(whole, np.cumsum(list(sizes.values()))[:-1])
        named = dict(zip(sizes, places, strict=True))
        self.commands: np.ndarray = named["commands"].reshape(REMEMBERED, 1 + muscles)
        self.ordered: np.ndarray = named["ordered"]
        self.valve_kpa: np.ndarray = named["valve_kpa"]  # what a valve gives whatever the command; nan without a fault
        self.run_rad_per_s: np.ndarray = named["run_rad_per_s"]
        self.counts: np.ndarray = named["counts"].reshape(2, sensors)
        self.ticks: np.ndarray = named["ticks"]
        self.written_s: np.ndarray = named["written_s"]  # when outputs were last written
        self.costs_s: np.ndarray = named["costs_s"]  # of a tick: last, largest, sum
        self.valve_kpa[:] = np.nan

    def order(self, now_s: float, command_kpa: list[float]) -> None:
        """Set the commanded pressures."""
        after = int(self.ordered[0]) + 1
        self.commands[after % REMEMBERED] = now_s, *command_kpa
        self.ordered[0] = after

    def ordered_at(self, at_s: float) -> np.ndarray:
        """Return the pressures, kPa, that were given at a time: the commanded ones, or those of a faulty valve."""
        newest = int(self.ordered[0])
        oldest = max(newest - REMEMBERED + 2, 1)
        place = next(
            (each for each in range(newest, oldest, -1) if self.commands[each % REMEMBERED, 0] <= at_s), oldest
        )
        return np.where(np.isnan(self.valve_kpa), self.commands[place % REMEMBERED, 1:], self.valve_kpa)

    def publish(self, counts: list[int]) -> None:
        """Show a new sample."""
        after = int(self.ticks[0]) + 1
        self.counts[after % 2] = counts
        self.ticks[0] = after

    def latest(self) -> list[int]:
        """Return the newest sample's counts."""
        return [int(each) for each in self.counts[int(self.ticks[0]) % 2]]
