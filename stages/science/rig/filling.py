"""How muscles are filled before a trial: evenly over most of the lead-in, then at rest until the trial begins.

The trial's first command flows in; the commands of the lead-in flow out. Nobody in the machine is filled against in
milliseconds, as the limits on the rate alone would permit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stages.science.plant.exoskeleton import Muscle
from stages.science.rig.limits import Limits
from stages.science.signals.trajectories import Array


def fill(first_kpa: Array, samples: int, share: float) -> Array:
    """Return the commands of a lead-in.

    Parameters
    ----------
    first_kpa : (M,) ndarray
        First command of the trial, as applied, kPa gauge.
    samples : int
        Samples of the lead-in, L; 0 where the trial begins with filled muscles.
    share : float
        Share of them over which the muscles are filled, 1.

    Returns
    -------
    (L, M) ndarray
        At one rate from vented to the first command, which then holds, kPa gauge. All muscles have the same share of
        their first commands at a time, so that what pulls against each other keeps to the limits that those keep to.

    Notes
    -----
    Of all ways to fill in a time this one has the smallest rate; valves round its ends off.
    """
    risen = np.minimum(np.arange(samples) / max(round(share * samples), 1), 1.0)
    return risen[:, None] * first_kpa


def check_filling(lead_in_s: float, share: float, limits: Limits, muscles: Sequence[Muscle]) -> None:
    """Check that every muscle can be filled to its highest command within its limit on the rate.

    Raises
    ------
    ValueError
        Naming the muscle, and how long it takes.
    """
    for muscle in muscles:
        limit = limits[muscle.type]
        shortest_s = limit.high_kpa / limit.slew_kpa_per_s / share
        if shortest_s > lead_in_s:
            raise ValueError(
                f"lead_in_s: expected at least {shortest_s:.3g} s, in whose filling_share {muscle.name} can be filled "
                f"to any command within limits.{muscle.type}.slew_kpa_per_s, got {lead_in_s}"
            )
