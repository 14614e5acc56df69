"""How late one signal follows another: both flow in, a delay flows out."""

from __future__ import annotations

import numpy as np

from stages.science.signals.trajectories import Array

LEAST_CORRELATION = 0.5
"""Correlation at the best delay below which a signal does not follow the other one."""


def find_delay(shown: Array, followed: Array, sampling_rate_hz: float, longest_s: float) -> float:
    """Return the delay of `followed`, s, by the largest correlation with what was shown, interpolated by a parabola.

    It is nan where the signals do not move, do not agree, or agree best at the longest delay.

    Parameters
    ----------
    shown, followed : (T,) ndarray
        Sampled at the same instants.
    sampling_rate_hz : float
        Samples per second.
    longest_s : float
        Longest delay that is looked for, s; shorter than half the signals.
    """
    lags = np.arange(min(int(longest_s * sampling_rate_hz), len(shown) // 2) + 1)
    correlation = np.array([_correlate(shown[: len(shown) - lag], followed[lag:]) for lag in lags])
    if not np.isfinite(correlation).all():
        return float("nan")
    best = int(np.argmax(correlation))
    if correlation[best] < LEAST_CORRELATION or best == lags[-1]:
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
