"""Smooth movements from posture to posture, and from pressure to pressure.

Via points flow in, or are drawn from a generator; a trajectory sampled at a fixed rate comes out.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def minimum_jerk(share: ArrayLike) -> Array:
    """Return the share of the way covered at a share of the time, with no velocity or acceleration at either end.

    Shares of time outside [0, 1] are held at its ends. It is the polynomial 10 s^3 - 15 s^4 + 6 s^5 of Flash and Hogan,
    The coordination of arm movements, J. Neurosci. 5 (1985).
    """
    s = np.clip(np.asarray(share, dtype=float), 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def connect_points(points: Array, start_s: Array, duration_s: Array, time_s: Array) -> Array:
    """Return the trajectory (T, J) that leaves each point at its time and reaches the next one with minimum jerk.

    Points are (N + 1, J) in any unit; movements, (N,), begin at `start_s` and last `duration_s`, zero for a step, and
    do not overlap. The trajectory is sampled at `time_s`, (T,).
    """
    last = np.searchsorted(start_s, time_s, side="right") - 1
    begun = last >= 0
    at = np.maximum(last, 0)
    steps = duration_s[at] <= 0.0
    lasting = np.where(steps, 1.0, duration_s[at])
    share = np.where(steps, begun, minimum_jerk(np.clip(time_s - start_s[at], 0.0, lasting) / lasting))
    return points[at] + share[:, None] * (points[at + 1] - points[at])


def reach_postures(
    generator: np.random.Generator,
    low: ArrayLike,
    high: ArrayLike,
    samples: int,
    sampling_rate_hz: float,
    move_s: tuple[float, float],
    rest_s: tuple[float, float],
) -> Array:
    """Draw a natural movement, (samples, J), rad: reaches of all joints together between random postures, with rests.

    Postures lie between `low` and `high`, (J,), rad; a reach and a rest take a shortest to a longest time, s.

    Raises
    ------
    ValueError
        When a range or a time makes no sense.
    """
    low, high = _check_schedule(low, high, sampling_rate_hz, move_s=move_s, rest_s=rest_s)
    shortest_s = max(move_s[0] + rest_s[0], 1.0 / sampling_rate_hz)
    count = int(np.ceil(samples / sampling_rate_hz / shortest_s))
    rests = generator.uniform(*rest_s, size=count)
    moves = generator.uniform(*move_s, size=count)
    points = generator.uniform(low, high, size=(count + 1, low.size))
    start_s = np.cumsum(rests + moves) - moves
    return np.clip(connect_points(points, start_s, moves, np.arange(samples) / sampling_rate_hz), low, high)


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
    """Draw one pressure command per muscle, (samples, M), kPa gauge, each on its own schedule.

    Held levels, uniform between `low_kpa` and `high_kpa`, (M,), kPa gauge, are joined by smooth ramps and by steps.

    Parameters
    ----------
    hold_s, transition_s : tuple of float
        Shortest and longest time that a level is held, and that a ramp takes, s.
    step_share : float
        Share of the transitions that are steps, between 0 and 1.

    Raises
    ------
    ValueError
        When a range is empty, the share is not between 0 and 1 or a time makes no sense.
    """
    low, high = _check_schedule(low_kpa, high_kpa, sampling_rate_hz, hold_s=hold_s, transition_s=transition_s)
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


def _check_schedule(
    low: ArrayLike, high: ArrayLike, sampling_rate_hz: float, **spans_s: tuple[float, float]
) -> tuple[Array, Array]:
    """Return a range as arrays of one shape; refuse one, a rate or spans of time that no schedule can be drawn from."""
    if not 0.0 < sampling_rate_hz < np.inf:
        raise ValueError(f"sampling_rate_hz: expected a positive rate, got {sampling_rate_hz}")
    for name, (shortest, longest) in spans_s.items():
        if not 0.0 <= shortest <= longest < np.inf:
            raise ValueError(f"{name}: expected 0 <= shortest <= longest, got {shortest} and {longest} s")
    lowest, highest = np.broadcast_arrays(np.atleast_1d(low).astype(float), np.atleast_1d(high).astype(float))
    if not (np.isfinite(lowest) & np.isfinite(highest) & (lowest <= highest)).all():
        raise ValueError(f"range: expected finite low <= high for each joint or muscle, got {lowest} and {highest}")
    return lowest, highest
