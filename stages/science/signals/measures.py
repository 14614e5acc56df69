"""How far a prediction is from a measurement, and how late one signal follows another."""

import numpy as np
from numpy.typing import ArrayLike

from stages.science.signals.trajectories import Array

LARGEST_VALUE = 1e150
SMALLEST_FORCE = 1e-150
"""Quotients of values between them are finite."""
LEAST_CORRELATION = 0.5
"""Correlation at the best delay below which a signal does not follow the other one."""


def rmse(predicted: ArrayLike, measured: ArrayLike) -> float:
    """Return the root mean square of the difference, in the unit of the data.

    Raises
    ------
    ValueError
        When shapes differ, there is nothing to compare or a value is absurdly large.
    """
    predicted, measured = np.asarray(predicted, dtype=float), np.asarray(measured, dtype=float)
    if predicted.shape != measured.shape or measured.size == 0:
        raise ValueError(
            f"expected predicted and measured of one shape, not empty; got {predicted.shape} and {measured.shape}"
        )
    largest = max(float(np.abs(predicted).max()), float(np.abs(measured).max()))
    if largest > LARGEST_VALUE:
        raise ValueError(f"expected values within {LARGEST_VALUE:g}, got {largest}")
    difference = predicted - measured
    # squares of values near 1 neither overflow nor vanish; a power of two leaves every digit as it is
    exponent = int(np.frexp(np.nan_to_num(np.abs(difference).max()))[1])
    return float(np.ldexp(np.sqrt(np.mean(np.ldexp(difference, -exponent) ** 2)), exponent))


def error_rate(predicted: ArrayLike, measured: ArrayLike) -> float:
    """Return the RMSE of forces, N, divided by the largest measured one (paper, section 5.1).

    Raises
    ------
    ValueError
        When shapes differ, there is nothing to compare, or no measured force is positive.
    """
    error = rmse(predicted, measured)
    largest = float(np.max(measured))
    if not largest > SMALLEST_FORCE:
        raise ValueError(f"expected a positive measured force to divide by, got a maximum of {largest} N")
    return error / largest


def find_delay(shown: Array, followed: Array, sampling_rate_hz: float, longest_s: float) -> float:
    """Return the delay of `followed`, s, by the largest correlation with what was shown, interpolated by a parabola.

    Both are (T,), sampled at the same instants; delays are looked for up to `longest_s`, s, and half the signals. It is
    nan where the signals do not move, do not agree, or agree best at the longest delay.
    """
    longest = min(int(longest_s * sampling_rate_hz), len(shown) // 2)
    correlation = [_correlate(shown[: len(shown) - lag], followed[lag:]) for lag in range(longest + 1)]
    if not np.isfinite(correlation).all():
        return float("nan")
    best = int(np.argmax(correlation))
    if correlation[best] < LEAST_CORRELATION or best == longest:
        return float("nan")
    shift = 0.0
    if best > 0:
        before, at, after = correlation[best - 1 : best + 2]
        shift = 0.5 * (before - after) / (before - 2.0 * at + after) if before + after < 2.0 * at else 0.0
    return float((best + shift) / sampling_rate_hz)


def _correlate(first: Array, second: Array) -> float:
    first, second = first - first.mean(), second - second.mean()
    size = np.sqrt((first @ first) * (second @ second))
    return float(first @ second / size) if size > 0.0 else float("nan")
