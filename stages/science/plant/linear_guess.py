"""What a record tells of a linear model before any fit: how quick it is, and its coefficients.

Signals of records flow in; a pace and least-squares coefficients flow out. Derivatives are never taken: input and
output pass the same filters (state-variable filters: Young, Parameter estimation for continuous-time models, Automatica
17, 1981), so that noise between samples does not matter.
"""

from collections.abc import Sequence

import numpy as np

from stages.science.signals.trajectories import Array


def find_pace(outputs: Sequence[Array], step_s: float) -> float:
    """Return the time, s, in which the output of records, (N_r,) without gaps, moves by a radian.

    Half of its power lies at slower motions.
    """
    power, frequency = [], []
    for each in outputs:
        moved = each - np.linspace(each[0], each[-1], len(each))
        spectrum = np.abs(np.fft.rfft((moved - moved.mean()) * np.hanning(len(each)))) ** 2
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
    """Return a signal (N,) without gaps and its derivatives up to an order, (N, order + 1).

    Each passes the same filter, 1 / (1 + tau s) to the power of order + 1.
    """
    from scipy.signal import bilinear, lfilter, lfilter_zi

    below = np.poly1d([tau_s, 1.0]) ** (order + 1)
    found = []
    for degree in range(order + 1):
        b, a = bilinear(np.eye(1, degree + 1)[0], below.coeffs, fs=1.0 / step_s)
        found.append(lfilter(b, a, signal, zi=lfilter_zi(b, a) * signal[0])[0])
    return np.stack(found, axis=1)


def regress(rows: Sequence[Array], target: Sequence[Array], skipped: int) -> Array:
    """Return the least-squares coefficients (C,) by which columns (N_r, C) of records add up to a target (N_r,).

    Samples in which the filters settle are skipped at the beginning of each record.
    """
    skip = [min(skipped, len(each) // 2) for each in target]
    columns = np.concatenate([each[k:] for each, k in zip(rows, skip, strict=True)])
    told = np.concatenate([each[k:] for each, k in zip(target, skip, strict=True)])
    size = np.maximum(np.sqrt((columns**2).mean(axis=0)), 1e-300)
    return np.linalg.lstsq(columns / size, told, rcond=1e-9)[0] / size
