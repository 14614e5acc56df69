"""Operators with memory but without time: stops, plays and the Bouc-Wen equation.

Arrays (T, K) flow in and out, each column on its own, from rest at the first sample. What comes out depends on the way
that the input took and not on its speed.
"""

import numpy as np
from numba import njit

from stages.science.signals.trajectories import Array


@njit(cache=True, error_model="numpy")
def follow_stops(signal: Array, widths: Array) -> Array:
    """Return the mean of stop operators of a signal (T, K), each between -1 and 1 and turning within its width.

    A width (E,) is the way from 0 to 1 of each operator, in the signal's unit. A
    stop is a spring with a slider: the element of the Maxwell-slip model. The operators carry equal force.
    """
    samples, columns = signal.shape
    mean = np.zeros((samples, columns))
    for m in range(columns):
        for width in widths:
            stop = 0.0
            for k in range(1, samples):
                stop = min(max(stop + (signal[k, m] - signal[k - 1, m]) / width, -1.0), 1.0)
                mean[k, m] += stop / widths.shape[0]
    return mean


@njit(cache=True, error_model="numpy")
def follow_play(signal: Array, radius: float) -> Array:
    """Return the play operator of a signal (T, K): it moves when the signal has gone `radius` past it."""
    play = np.empty_like(signal)
    play[0] = signal[0]
    for k in range(1, signal.shape[0]):
        for m in range(signal.shape[1]):
            play[k, m] = max(signal[k, m] - radius, min(signal[k, m] + radius, play[k - 1, m]))
    return play


@njit(cache=True, error_model="numpy")
def follow_bouc_wen(signal: Array, width: float) -> Array:
    """Return the state z, between -1 and 1, of the Bouc-Wen equation over a signal (T, K).

    Exponent 1 and equal coefficients: dz/dx = ``(1 - |z|) / width`` while z grows in size and 1 / width while it
    shrinks, solved exactly for an input that runs straight from sample to sample.
    """
    state = np.zeros_like(signal)
    for k in range(1, signal.shape[0]):
        for m in range(signal.shape[1]):
            way = (signal[k, m] - signal[k - 1, m]) / width
            direction = 1.0 if way > 0.0 else -1.0
            z, left = direction * state[k - 1, m], abs(way)
            if z < 0.0:
                back = min(-z, left)
                z, left = z + back, left - back
            if left > 0.0:
                z = 1.0 - (1.0 - z) * np.exp(-left)
            state[k, m] = direction * z
    return state
