"""Linear filters of sampled signals (T, K), each column on its own: a lag that starts settled, and a shift in time."""

from __future__ import annotations

import numpy as np
from numba import njit

from stages.science.signals.trajectories import Array


@njit(cache=True, error_model="numpy")
def _lag_straight(signal: Array, decay: float, last: float, now: float) -> Array:
    lagged = np.empty_like(signal)
    lagged[0] = signal[0]
    for k in range(1, signal.shape[0]):
        for m in range(signal.shape[1]):
            lagged[k, m] = decay * lagged[k - 1, m] + last * signal[k - 1, m] + now * signal[k, m]
    return lagged


def lag(signal: Array, tau_s: float, step_s: float) -> Array:
    """Return the exact first-order lag of a signal (T, K) that runs straight from sample to sample.

    It starts settled at the first sample; a time constant of zero returns the signal itself.
    """
    if tau_s <= 0.0:
        return signal
    ratio = step_s / tau_s
    decay = np.exp(-ratio)
    mean = -np.expm1(-ratio) / ratio
    return _lag_straight(np.ascontiguousarray(signal), decay, mean - decay, 1.0 - mean)


def shift(signal: Array, samples: float) -> Array:
    """Return a signal (T, K) later by a number of samples, earlier if negative; its ends are held.

    Within a sample the signal runs straight.
    """
    last = len(signal) - 1
    position = np.clip(np.arange(last + 1) - samples, 0.0, last)
    before = np.minimum(position.astype(np.int64), max(last - 1, 0))
    share = (position - before)[:, None]
    after = np.minimum(before + 1, last)
    return (1.0 - share) * signal[before] + share * signal[after]
