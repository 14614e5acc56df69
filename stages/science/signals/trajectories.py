"""Smooth movements from posture to posture.

Via points flow in, or are drawn from a generator; a trajectory sampled at a fixed rate comes out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def minimum_jerk(share: ArrayLike) -> Array:
    """Return the share of the way covered at a share of the time, with no velocity or acceleration at either end.

    Shares of time outside [0, 1] are held at its ends.

    Notes
    -----
    Flash and Hogan, The coordination of arm movements, J. Neurosci. 5 (1985): the polynomial 10 s^3 - 15 s^4 + 6 s^5.
    """
    s = np.clip(np.asarray(share, dtype=float), 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def connect_points(points: Array, start_s: Array, duration_s: Array, time_s: Array) -> Array:
    """Return the trajectory (T, J) that leaves each point at its time and reaches the next one with minimum jerk.

    Parameters
    ----------
    points : (N + 1, J) ndarray
        Postures, in any unit.
    start_s, duration_s : (N,) ndarray
        When each movement begins and how long it lasts; movements do not overlap. A duration of zero is a step.
    time_s : (T,) ndarray
        Where to sample.
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

    Parameters
    ----------
    generator : numpy.random.Generator
        The only source of randomness.
    low, high : (J,) array_like
        Range of each joint's postures, rad.
    samples : int
        Length of the trajectory.
    sampling_rate_hz : float
        Samples per second.
    move_s, rest_s : tuple of float
        Shortest and longest duration of a reach and of a rest, s.

    Raises
    ------
    ValueError
        When a range or a time makes no sense.
    """
    check_schedule(sampling_rate_hz, move_s=move_s, rest_s=rest_s)
    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    if not (np.isfinite(low) & np.isfinite(high) & (low <= high)).all():
        raise ValueError(f"range of postures: expected finite low <= high for each joint, got {low} and {high} rad")
    shortest_s = max(move_s[0] + rest_s[0], 1.0 / sampling_rate_hz)
    count = int(np.ceil(samples / sampling_rate_hz / shortest_s))
    rests = generator.uniform(*rest_s, size=count)
    moves = generator.uniform(*move_s, size=count)
    points = generator.uniform(low, high, size=(count + 1, low.size))
    start_s = np.cumsum(rests + moves) - moves
    return np.clip(connect_points(points, start_s, moves, np.arange(samples) / sampling_rate_hz), low, high)


def check_schedule(sampling_rate_hz: float, **spans_s: tuple[float, float]) -> None:
    """Refuse a rate or spans of time that no schedule can be drawn from.

    Raises
    ------
    ValueError
        Naming the one that makes no sense.
    """
    if not 0.0 < sampling_rate_hz < np.inf:
        raise ValueError(f"sampling_rate_hz: expected a positive rate, got {sampling_rate_hz}")
    for name, (shortest, longest) in spans_s.items():
        if not 0.0 <= shortest <= longest < np.inf:
            raise ValueError(f"{name}: expected 0 <= shortest <= longest, got {shortest} and {longest} s")
