"""Pressure profiles that excite muscles: held levels, joined by smooth ramps and by steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from stages.science.signals.trajectories import Array, check_schedule, connect_points


def pressure_profiles(
    generator: np.random.Generator,
    low_kpa: ArrayLike,
    high_kpa: ArrayLike,
    samples: int,
    sampling_rate_hz: float,
    *,
    hold_s: tuple[float, float],
    transition_s: tuple[float, float],
    step_share: float,
) -> Array:
    """Draw one pressure command per muscle, (T, M), kPa gauge, each on its own schedule.

    Parameters
    ----------
    generator : numpy.random.Generator
        The only source of randomness.
    low_kpa, high_kpa : (M,) array_like
        Range of each muscle's levels, kPa gauge; levels are drawn uniformly.
    samples : int
        Length T of the profile.
    sampling_rate_hz : float
        Samples per second.
    hold_s, transition_s : tuple of float
        Shortest and longest time that a level is held, and that a ramp takes, s.
    step_share : float
        Share of the transitions that are steps, between 0 and 1.

    Raises
    ------
    ValueError
        When a range is empty, the share is not between 0 and 1 or a time makes no sense.
    """
    check_schedule(sampling_rate_hz, hold_s=hold_s, transition_s=transition_s)
    low, high = np.broadcast_arrays(np.atleast_1d(low_kpa).astype(float), np.atleast_1d(high_kpa).astype(float))
    if not (np.isfinite(low) & np.isfinite(high) & (low <= high)).all():
        raise ValueError(f"pressure range: expected low <= high for each muscle, got low {low} and high {high} kPa")
    if not 0.0 <= step_share <= 1.0:
        raise ValueError(f"step_share: expected a share between 0 and 1, got {step_share}")
    shortest_s = max(hold_s[0] + (0.0 if step_share else transition_s[0]), 1.0 / sampling_rate_hz)
    count = int(np.ceil(samples / sampling_rate_hz / shortest_s))
    time_s = np.arange(samples) / sampling_rate_hz
    profiles = []
    for lowest, highest in zip(low, high, strict=True):
        levels = generator.uniform(lowest, highest, size=(count + 1, 1))
        steps = generator.random(count) < step_share
        ramps = np.where(steps, 0.0, generator.uniform(*transition_s, size=count))
        holds = generator.uniform(*hold_s, size=count)
        start_s = np.cumsum(holds + ramps) - ramps
        profiles.append(connect_points(levels, start_s, ramps, time_s)[:, 0])
    return np.clip(np.stack(profiles, axis=1), low, high)
