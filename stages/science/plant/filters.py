"""Filters of sampled signals, each column on its own: lags, a resonance, a shift in time, and a reading that ends."""

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


def lag(signal: Array, tau_s: float, step_s: float, held: bool = False) -> Array:
    """Return the exact first-order lag of a signal (T, K) that runs straight from sample to sample, or is held.

    It starts settled at the first sample; a time constant of zero returns the signal itself.
    """
    if tau_s <= 0.0:
        return signal
    ratio = step_s / tau_s
    decay = np.exp(-ratio)
    if held:
        return _lag_straight(np.ascontiguousarray(signal), decay, 1.0 - decay, 0.0)
    mean = -np.expm1(-ratio) / ratio
    return _lag_straight(np.ascontiguousarray(signal), decay, mean - decay, 1.0 - mean)


@njit(cache=True, error_model="numpy")
def _resonate(signal: Array, damping: float, step: float) -> Array:
    """Return the response to a signal (T, K); `step` is the time between samples in units of one over the frequency."""
    turn = np.sqrt(1.0 - damping**2)
    fall, cosine, sine = np.exp(-damping * step), np.cos(turn * step), np.sin(turn * step) / turn
    shown = np.empty_like(signal)
    shown[0] = signal[0]
    for m in range(signal.shape[1]):
        rate = 0.0
        for k in range(1, signal.shape[0]):
            slope = (signal[k, m] - signal[k - 1, m]) / step
            left, speed = shown[k - 1, m] - signal[k - 1, m] + 2.0 * damping * slope, rate - slope
            shown[k, m] = signal[k, m] - 2.0 * damping * slope
            shown[k, m] += fall * (left * (cosine + damping * sine) + speed * sine)
            rate = slope + fall * (speed * (cosine - damping * sine) - left * sine)
    return shown


def resonate(signal: Array, tau_s: float, damping: float, step_s: float) -> Array:
    """Return the exact response of a resonator to a signal (T, K) that runs straight from sample to sample.

    Of its undamped frequency `tau_s` is one over, per rad; the damping ratio is below one. It is at rest at the first
    sample; a time constant of zero returns the signal itself.
    """
    return signal if tau_s <= 0.0 else _resonate(np.ascontiguousarray(signal), damping, step_s / tau_s)


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

    The muscles start filled to the first command. Time constants of filling and venting are (K,), s; zero follows the
    command one sample later.
    """
    rise, fall = (np.exp(-step_s / np.maximum(tau, 1e-9)) for tau in (rise_tau_s, fall_tau_s))
    return _lag_columns(np.ascontiguousarray(command_kpa, dtype=float), rise, fall)


def read(signal: Array, unread: Array | float, lowest: Array | float, highest: Array | float) -> Array:
    """Return what a sensor that ends shows of a signal (T, ...): less a share of what lies beyond its ends.

    The share that is not read is 1 for a sensor that stops there, and 0 for one that shows the signal bit for bit; ends
    are in the signal's unit, infinite where there is none.
    """
    if not np.any(unread):
        return signal
    shown = np.clip(signal, lowest, highest)
    left = (1.0 - np.asarray(unread)) * (signal - shown)
    return np.where(np.equal(unread, 0.0), signal, shown + left)
