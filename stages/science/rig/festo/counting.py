"""Raw counts of a connected device, with nothing commanded or with one muscle held at a pressure.

A link and a time flow in; the counts of all inputs over that time flow out. While a muscle is held the device's
watchdog is armed; the muscle is filled and let down along ramps, and let down whatever happens.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from stages.science.rig.contract import RigError
from stages.science.rig.festo.channels import ChannelMap, CountRange
from stages.science.rig.festo.cpx_link import CpxLink, LinkLost
from stages.science.rig.festo.depressurise import depressurise
from stages.science.rig.festo.held_signals import hold_signals
from stages.science.rig.limits import Ceiling
from stages.science.rig.pacing import pace
from stages.science.signals.trajectories import Array

Judge = Callable[[Array], str]
"""Takes the counts of all inputs and returns why the muscle is let down at once; empty where it is held on."""


@dataclass(frozen=True, eq=False)
class CountRecording:
    """Counts of K inputs in T samples.

    Parameters
    ----------
    names : list of str
        Of the inputs, as ``pam1.force``.
    time_s : (T,) ndarray
        From the first sample, s.
    counts : (T, K) ndarray
        As the device tells them.
    command_count : int or None
        What was written to the regulator of the muscle that was held; None where none was.
    stopped : str
        Why the muscle was let down before the time was over; empty where it was held throughout.
    """

    names: list[str]
    time_s: Array
    counts: Array
    command_count: int | None = None
    stopped: str = ""


@dataclass(frozen=True)
class Hold:
    """How one muscle is held.

    Parameters
    ----------
    muscle : int
        Its position among the muscles.
    command_kpa : float
        What is commanded, kPa gauge.
    ramp_s : float
        Time to fill it, and to let it down, s.
    settle_s : float
        Time at the command before the record begins, s.
    ramp_down_s : float
        Longest time to let it down where it is let down early, s.
    """

    muscle: int
    command_kpa: float
    ramp_s: float
    settle_s: float
    ramp_down_s: float


class CountJudge:
    """Says why a held muscle is to be let down at once, as far as channels that are not calibrated yet can tell.

    Parameters
    ----------
    channels : ChannelMap
        What counts are configured to mean.
    counts : CountRange
        Which counts are values.
    ceilings : sequence of Ceiling
        By muscle: the largest pressure, kPa gauge, and tension, N.
    muscle : int
        The one that is held: a channel of another muscle that is at its end says nothing about it.
    """

    def __init__(self, channels: ChannelMap, counts: CountRange, ceilings: Sequence[Ceiling], muscle: int):
        self.channels, self.counts, self.muscle = channels, counts, muscle
        self.largest = np.array([each.pressure_kpa for each in ceilings] + [each.force_n for each in ceilings])
        self.units = ["kPa"] * len(ceilings) + ["N"] * len(ceilings)

    def __call__(self, counts: Array) -> str:
        """Judge the counts of all inputs."""
        muscles = len(self.largest) // 2
        pressure, force, _ = self.channels.to_values(counts)
        values, analogue = np.concatenate([pressure, force]), counts[: 2 * muscles]
        valid = ~np.isin(analogue, self.counts.none) & (self.counts.low <= analogue) & (analogue < self.counts.high)
        over = np.flatnonzero(valid & (values > self.largest))
        if over.size:
            first = int(over[0])
            name, unit = self.channels.names[first], self.units[first]
            return f"{name} at {values[first]:.0f} {unit}, ceiling {self.largest[first]} {unit}"
        if not valid[self.muscle]:
            return f"{self.channels.names[self.muscle]} cannot tell the pressure (count {analogue[self.muscle]:.0f})"
        return ""


def record_counts(link: CpxLink, rate_hz: float, record_s: float) -> CountRecording:
    """Record the counts of all inputs; no output is touched.

    Raises
    ------
    RigError
        When the device does not answer.
    """
    ticks = max(round(record_s * rate_hz), 2)
    taken: list[tuple[float, Array]] = []
    try:
        for tick in pace(ticks, 1.0 / rate_hz):
            taken.append((tick.index / rate_hz, link.read()))
    except LinkLost as error:
        raise RigError(f"the device at {link.place} does not answer ({error}); check its power and its cable") from None
    return _collect(link, taken)


def record_held(link: CpxLink, rate_hz: float, record_s: float, hold: Hold, judge: Judge) -> CountRecording:
    """Fill one muscle, record the counts of all inputs at its command, and let it down.

    Raises
    ------
    RigError
        When the device does not answer, or could not be reached to let the muscle down: then its watchdog does.
    """
    period_s, watchdog_s = 1.0 / rate_hz, link.device.watchdog_s
    rise, first = max(round(hold.ramp_s * rate_hz), 1), round((hold.ramp_s + hold.settle_s) * rate_hz)
    ticks = first + max(round(record_s * rate_hz), 2)
    target = np.zeros(len(link.channels.commands))
    target[hold.muscle] = hold.command_kpa
    taken: list[tuple[float, Array]] = []
    reason, lost, share = "", "", 0.0
    with hold_signals() as signals:
        try:
            link.arm()
            for tick in pace(ticks, period_s):
                silent_s = link.longest_silence_s
                if silent_s > 0.5 * watchdog_s:
                    reason = f"the loop came {1e3 * silent_s:.0f} ms late (half the watchdog's time is borne)"
                    break
                counts = link.read()
                reason = signals.name or judge(counts)
                if reason:
                    break
                share = min((tick.index + 1) / rise, 1.0)
                link.write(share * target)
                if tick.index >= first:
                    taken.append(((tick.index - first) * period_s, counts))
        except LinkLost as error:
            lost = str(error)
        finally:
            ramp_s = min(hold.ramp_s * share, hold.ramp_down_s if reason else np.inf)
            unreached = depressurise(link, share * target, max(ramp_s, period_s), period_s, _pass_over, lost)
    if lost or unreached:
        how = (
            f"its watchdog lets the muscle down, {watchdog_s} s after the last request"
            if unreached
            else "it was let down"
        )
        raise RigError(
            f"the device at {link.place} does not answer ({lost or unreached}); {how}; see that the muscles are "
            "without air before anybody goes on"
        )
    return _collect(link, taken, link.channels.to_counts(target)[hold.muscle], reason)


def _collect(
    link: CpxLink, taken: list[tuple[float, Array]], command_count: int | None = None, stopped: str = ""
) -> CountRecording:
    names = list(link.channels.names)
    counts = np.array([each for _, each in taken]).reshape(len(taken), len(names))
    return CountRecording(names, np.array([each for each, _ in taken]), counts, command_count, stopped)


def _pass_over(counts: Array, command_kpa: Array) -> None:
    """Take no notice of what is read on the way down."""
