"""What a record tells of a linear model before any fit: how quick it is, and its coefficients.

Signals of records flow in; a pace and least-squares coefficients flow out. Derivatives are never taken: input and
output pass the same filters (state-variable filters: Young, Parameter estimation for continuous-time models, Automatica
17, 1981), so that noise between samples does not matter.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stages.science.signals.trajectories import Array


def find_pace(outputs: Sequence[Array], step_s: float) -> float:
    """Return the time in which an output moves by a radian, s: half of its power lies at slower motions.

    Parameters
    ----------
    outputs : sequence of (N_r,) ndarray
        Of each record, without gaps.
    step_s : float
        Time between samples, s.
    """
    power, frequency = [], []
    for each in outputs:
        moved = each - np.linspace(each[0], each[-1], len(each))
        taper = np.hanning(len(each))
        spectrum = np.abs(np.fft.rfft((moved - moved.mean()) * taper)) ** 2
        power.append(spectrum[1:])
        frequency.append(np.fft.rfftfreq(len(each), step_s)[1:])
    at, much = np.concatenate(frequency), np.concatenate(power)
    if much.sum() <= 0.0:
        return 10.0 * step_s
    order = np.argsort(at)
    below = np.cumsum(much[order]) / much.sum()
    middle = at[order][np.searchsorted(below, 0.5)]
    return float(1.0 / (2.0 * np.pi * middle))


def filter_derivatives(signal: Array, order: int, tau_s: float, step_s: float) -> Array:
    """Return a signal and its derivatives up to an order, each through the same low-pass, (N, order + 1).

    Parameters
    ----------
    signal : (N,) ndarray
        Without gaps.
    order : int
        Of the highest derivative.
    tau_s : float
        Time constant of the filter 1 / (1 + tau s) to the power of order + 1, s.
    step_s : float
        Time between samples, s.
    """
    from scipy.signal import bilinear, lfilter, lfilter_zi

    below = np.poly1d([tau_s, 1.0]) ** (order + 1)
    found = []
    for degree in range(order + 1):
        above = np.zeros(degree + 1)
        above[0] = 1.0
        b, a = bilinear(above, below.coeffs, fs=1.0 / step_s)
        found.append(lfilter(b, a, signal, zi=lfilter_zi(b, a) * signal[0])[0])
    return np.stack(found, axis=1)


def regress(rows: Sequence[Array], target: Sequence[Array], skipped: int) -> Array:
    """Return least-squares coefficients of filtered columns, (C,), without each record's first samples.

    Parameters
    ----------
    rows : sequence of (N_r, C) ndarray
        Columns of each record.
    target : sequence of (N_r,) ndarray
        What they are to add up to.
    skipped : int
        Samples in which the filters settle.
    """
    skip = [min(skipped, len(each) // 2) for each in target]
    columns = np.concatenate([each[k:] for each, k in zip(rows, skip, strict=True)])
    told = np.concatenate([each[k:] for each, k in zip(target, skip, strict=True)])
    size = np.maximum(np.sqrt((columns**2).mean(axis=0)), 1e-300)
    found: Array = np.linalg.lstsq(columns / size, told, rcond=1e-9)[0] / size
    return found
