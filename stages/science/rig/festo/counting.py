"""Raw counts of a connected device, with nothing commanded or with one muscle held at a pressure.

A link and a time flow in; the counts of all inputs over that time flow out. While a muscle is held the device's
watchdog is armed; the muscle is filled and let down along ramps, and let down whatever happens.
"""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stages.science.rig.contract import RigError
from stages.science.rig.festo.cpx_link import CpxLink, LinkLost
from stages.science.rig.festo.depressurise import depressurise
from stages.science.rig.festo.held_signals import hold_signals
from stages.science.rig.limits import Ceiling
from stages.science.rig.pacing import pace
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


def record_counts(link: CpxLink, rate_hz: float, record_s: float) -> CountRecording:
    """Record the counts of all inputs; no output is touched.

    Raises
    ------
    RigError
        When the device does not answer.
    """
    ticks = pace(max(round(record_s * rate_hz), 2), 1.0 / rate_hz)
    try:
        taken = [(tick.index / rate_hz, link.read()) for tick in ticks]
    except LinkLost as error:
        raise RigError(f"the device at {link.place} does not answer ({error}); check its power and its cable") from None
    return _collect(link, taken)


def record_held(
    link: CpxLink,
    rate_hz: float,
    record_s: float,
    *,
    muscle: int,
    command_kpa: float,
    ceilings: Sequence[Ceiling],
    ramp_s: float,
    settle_s: float,
    ramp_down_s: float,
) -> CountRecording:
    """Fill one muscle, given by its position, record the counts of all inputs at its command, and let it down.

    What passes a muscle's ceiling lets it down at once, in `ramp_down_s` at most, as far as channels that are not
    calibrated yet can tell; else it is filled and let down in `ramp_s`. The record begins `settle_s` after the filling.

    Raises
    ------
    RigError
        When the device does not answer, or could not be reached to let the muscle down: then its watchdog does.
    """
    period_s, watchdog_s = 1.0 / rate_hz, link.device.watchdog_s
    rise, first = max(round(ramp_s * rate_hz), 1), round((ramp_s + settle_s) * rate_hz)
    ticks = first + max(round(record_s * rate_hz), 2)
    target = np.zeros(len(link.channels.commands))
    target[muscle] = command_kpa
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
                reason = signals.name or _judge(link, counts, ceilings, muscle)
                if reason:
                    break
                share = min((tick.index + 1) / rise, 1.0)
                link.write(share * target)
                if tick.index >= first:
                    taken.append(((tick.index - first) * period_s, counts))
        except LinkLost as error:
            lost = str(error)
        finally:
            down_s = min(ramp_s * share, ramp_down_s if reason else np.inf)
            unreached = depressurise(link, share * target, max(down_s, period_s), period_s, lambda *_: None, lost)
    with contextlib.suppress(LinkLost):  # an armed watchdog vents what is vented already
        link.disarm()
    if lost or unreached:
        late = f"its watchdog lets the muscle down, {watchdog_s} s after the last request"
        how = late if unreached else "it was let down"
        raise RigError(
            f"the device at {link.place} does not answer ({lost or unreached}); {how}; see that the muscles are "
            "without air before anybody goes on"
        )
    return _collect(link, taken, link.channels.to_counts(target)[muscle], reason)


def _collect(
    link: CpxLink, taken: list[tuple[float, Array]], command_count: int | None = None, stopped: str = ""
) -> CountRecording:
    names = list(link.channels.names)
    counts = np.array([each for _, each in taken]).reshape(len(taken), len(names))
    return CountRecording(names, np.array([each for each, _ in taken]), counts, command_count, stopped)


def _judge(link: CpxLink, counts: Array, ceilings: Sequence[Ceiling], muscle: int) -> str:
    """Return why a held muscle is let down at once; a channel of another one at its end says nothing about it."""
    valid, names = link.device.counts, link.channels.names
    pressure, force, _ = link.channels.to_values(counts)
    values, analogue = np.concatenate([pressure, force]), counts[: 2 * len(ceilings)]
    largest = np.array([each.pressure_kpa for each in ceilings] + [each.force_n for each in ceilings])
    told = ~np.isin(analogue, valid.none) & (valid.low <= analogue) & (analogue < valid.high)
    over = np.flatnonzero(told & (values > largest))
    if over.size:
        first = int(over[0])
        unit = "kPa" if first < len(ceilings) else "N"
        return f"{names[first]} at {values[first]:.0f} {unit}, ceiling {largest[first]} {unit}"
    return "" if told[muscle] else f"{names[muscle]} cannot tell the pressure (count {analogue[muscle]:.0f})"
