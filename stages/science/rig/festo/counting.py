"""Raw counts of a connected device, and why a muscle that is held at a pressure is let down at once.

Counts of all inputs flow in, sample after sample; the record of them flows out.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stages.science.rig.festo.cpx_link import CpxLink
from stages.science.rig.limits import Ceiling
from stages.science.signals.trajectories import Array


@dataclass(frozen=True, eq=False)
class CountRecording:
    """Counts (T, K) of K inputs in T samples, as the device tells them."""

    names: list[str]
    time_s: Array
    counts: Array
    command_count: int | None = None
    """What was written to the regulator of the muscle that was held."""
    stopped: str = ""
    """Why the muscle was let down before the time was over; empty where it was held throughout."""


def collect_counts(
    link: CpxLink, taken: list[tuple[float, Array]], command_count: int | None = None, stopped: str = ""
) -> CountRecording:
    """Return the record of times, s, and the counts of all inputs at them."""
    names = list(link.channels.names)
    counts = np.array([each for _, each in taken]).reshape(len(taken), len(names))
    return CountRecording(names, np.array([each for each, _ in taken]), counts, command_count, stopped)


def judge_held(link: CpxLink, counts: Array, ceilings: Sequence[Ceiling], muscle: int) -> str:
    """Return why a held muscle is let down at once; a channel of another one at its end says nothing about it."""
    names = link.channels.names
    pressure, force, _ = link.channels.to_values(counts)
    values, analogue = np.concatenate([pressure, force]), counts[: 2 * len(ceilings)]
    largest = np.array([each.pressure_kpa for each in ceilings] + [each.force_n for each in ceilings])
    told = ~np.logical_or(*link.device.counts.sort_out(analogue))
    over = np.flatnonzero(told & (values > largest))
    if over.size:
        first = int(over[0])
        unit = "kPa" if first < len(ceilings) else "N"
        return f"{names[first]} at {values[first]:.0f} {unit}, ceiling {largest[first]} {unit}"
    return "" if told[muscle] else f"{names[muscle]} cannot tell the pressure (count {analogue[muscle]:.0f})"
