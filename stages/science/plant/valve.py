"""The valve: a first-order lag between command and pressure, solved exactly for a held command."""

from __future__ import annotations

import numpy as np
from numba import njit

from stages.science.signals.trajectories import Array


@njit(cache=True, error_model="numpy")
def _lag_columns(signal: Array, rise_decay: Array, fall_decay: Array) -> Array:
    lagged = np.empty_like(signal)
    lagged[0] = signal[0]
    for k in range(signal.shape[0] - 1):
        for m in range(signal.shape[1]):
            gap = lagged[k, m] - signal[k, m]
            decay = rise_decay[m] if gap < 0.0 else fall_decay[m]
            lagged[k + 1, m] = signal[k, m] + decay * gap
    return lagged


def respond(command_kpa: Array, rise_tau_s: Array, fall_tau_s: Array, step_s: float) -> Array:
    """Return the pressure (T, K), kPa gauge, under a command that is held from each sample to the next.

    Parameters
    ----------
    command_kpa : (T, K) ndarray
        Commanded pressure; the muscles start filled to the first one.
    rise_tau_s, fall_tau_s : (K,) ndarray
        Time constants of filling and venting, s; zero follows the command one sample later.
    step_s : float
        Time between samples, s.
    """
    rise, fall = (np.exp(-step_s / np.maximum(tau, 1e-9)) for tau in (rise_tau_s, fall_tau_s))
    return _lag_columns(np.ascontiguousarray(command_kpa, dtype=float), rise, fall)
