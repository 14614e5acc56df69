"""How muscles are let down: along a ramp, or at once where the device has vented them meanwhile.

A link and what was commanded last flow in; out flows why the muscles could not be let down, if they could not. The
watchdog stays armed; a device that cannot be told is asked for nothing more, so that its watchdog does it.
"""

import contextlib
from collections.abc import Callable

import numpy as np

from stages.science.rig import clock
from stages.science.rig.festo.cpx_link import CpxLink, LinkLost
from stages.science.signals.trajectories import Array

TRIED_S = 0.15
"""Time beyond the ramp for which a device is tried to be reached, s: each try keeps its watchdog from acting."""

Look = Callable[[Array, Array], None]
"""Is handed the counts of all inputs and the command, kPa gauge, at each step."""


def depressurise(link: CpxLink, last_kpa: Array, ramp_s: float, period_s: float, look: Look, problem: str = "") -> str:
    """Let all muscles down from their last commands (M,), kPa gauge, step by step.

    What is read on the way is looked at. Where the link has a problem already, zero is commanded at once, on a
    connection of its own. Returned is why the device could not be told, the link being closed then; empty where it
    confirmed commands of zero.
    """
    begun, steps = clock.now_s(), max(round(ramp_s / period_s), 1)
    if problem:
        _reopen(link)
    while True:
        passed_s = clock.now_s() - begun
        vented = link.longest_silence_s > link.device.watchdog_s  # by the watchdog, which a ramp would undo
        share = 1.0 if vented or problem else min((np.floor(passed_s / period_s) + 1) / steps, 1.0)
        try:
            link.write((1.0 - share) * last_kpa)
            if share == 1.0:
                break
            look(link.read(), (1.0 - share) * last_kpa)
        except LinkLost as error:
            if problem and clock.now_s() - begun > ramp_s + TRIED_S:
                link.close()
                return str(error)
            problem = str(error)
            _reopen(link)
        clock.sleep(begun + (np.floor(passed_s / period_s) + 1) * period_s - clock.now_s())
    return ""


def _reopen(link: CpxLink) -> None:
    with contextlib.suppress(LinkLost):
        link.reopen()
