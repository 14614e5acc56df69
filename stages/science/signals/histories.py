"""What a signal was: where it was lately, how it changes, and the distance moved so far; columns in and out."""

from collections.abc import Mapping

import numpy as np

from stages.science.signals.trajectories import Array

HISTORIES = CHANGE, DISTANCE, RECENT = "change of", "distance by", "recent"
"""What histories of signals are called, before the signal's name."""
CHANGE_PACES, RECENT_PACES = 0.06, 0.2
"""Time constants of the lags by which changes and recent values are told, in time scales of the motion."""


def lag(signal: Array, tau: float, step: float) -> Array:
    """Return a first-order lag of each column, from rest at its first value; tau and step in one unit of time."""
    from scipy.signal import lfilter  # half a second that a run without it is spared

    decay = float(np.exp(-step / tau))
    return np.asarray(lfilter([1.0 - decay], [1.0, -decay], signal, axis=0, zi=decay * signal[:1])[0])


def change(signal: Array, paces: float) -> Array:
    """Return how a signal differs from what it was lately; `paces` lie between samples."""
    return signal - lag(signal, CHANGE_PACES, paces)


def recall(signal: Array, paces: float) -> Array:
    """Return what a signal was lately; `paces` lie between samples."""
    return lag(signal, RECENT_PACES, paces)


def sum_distance(rate: Array, step_s: float) -> Array:
    """Return the distance moved since the first sample at a rate, per second."""
    return np.asarray(np.cumsum(np.abs(rate), axis=0) * step_s)


def find_signal(name: str, signals: Mapping[str, Array], step_s: float, time_scale_s: float) -> Array:
    """Return a signal, or the history that a name tells, of signals by name; `ValueError` where there is none."""
    if name in signals:
        return signals[name]
    before = next((each for each in HISTORIES if name.startswith(f"{each} ")), "")
    own = name.removeprefix(f"{before} ")
    if not before or own not in signals:
        raise ValueError(f"no signal '{name}'; known are {', '.join(signals)}")
    if before == DISTANCE:
        return sum_distance(signals[own], step_s)
    return (change if before == CHANGE else recall)(signals[own], step_s / time_scale_s)
