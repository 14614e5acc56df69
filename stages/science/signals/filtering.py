"""The derivative of a sampled signal, and the same signal with less noise or at a lower rate."""

from collections.abc import Sequence

import numpy as np

from stages.science.signals.trajectories import Array

MEDIAN, WORSE, ERRORS = 0.6745, 1.25, 3.0
"""Median size of a standard normal deviate; squared difference over that which noise alone makes, beside so many of its
standard errors, from which two windows differ by more."""
LAGS_S = tuple(0.005 * 2.0**each for each in range(7))
DELAYS_S = (0.0, 0.01, 0.02, 0.04, 0.08)
"""Time constants and delays of valves that are tried first, up to a third and a twelfth of a second."""
REFINED_OCTAVES = (0.5, 0.25, 0.125, 0.0625, 0.03125)
"""Steps of the time constant about the best; those of the delay, to one sample, and of a second lag shrink alike."""


def differentiate(signal: Array, sampling_rate_hz: float, window_s: float, order: int) -> Array:
    """Return the zero-phase filtered derivative of each column of a signal (T, ...), in its unit per second.

    A polynomial of that order, at least 1, is fitted by least squares in a window around each sample and differentiated
    there; at the ends the first and last whole windows serve. The window, s, is rounded to an odd number of samples
    that holds the polynomial (Savitzky and Golay, Smoothing and differentiation of data by simplified least squares
    procedures, Anal. Chem. 36, 1964).

    Raises
    ------
    ValueError
        When the signal is shorter than the window or not finite, or the order or the rate makes no sense.
    """
    from scipy.signal import savgol_filter  # half a second that a run with nothing to differentiate is spared

    if order < 1 or not 0.0 < sampling_rate_hz < float("inf"):
        raise ValueError(
            f"differentiate: expected an order of at least 1 and a positive rate, got {order} and {sampling_rate_hz} Hz"
        )
    length = window_length(sampling_rate_hz, window_s, order)
    if len(signal) < length:
        raise ValueError(f"differentiate: expected at least {length} samples (window_s {window_s}), got {len(signal)}")
    return savgol_filter(signal, length, order, deriv=1, delta=1.0 / sampling_rate_hz, axis=0)


def choose_window(
    signals: Sequence[Array], sampling_rate_hz: float, longest_s: float, order: int, derivative: int
) -> float:
    """Return the window, s, through which polynomials tell signals (N_r,) with one white noise, or a derivative, best.

    Of none, the longest and its halves, it is the longest one through which that differs from what each shorter one
    tells by no more than the noise of the latter (Lepskii, On a problem of adaptive estimation in Gaussian white noise,
    Theory Probab. Appl. 35, 1991). The noise is told by fifth differences: for a derivative by their mean square, which
    sees the steps of an encoder, for the signal itself by their median, as its own steps are no noise. A derivative of
    what mostly repeats itself takes the longest; without a window, 0, there is none.
    """
    from scipy.signal import savgol_coeffs, savgol_filter

    if derivative and np.median(np.abs(np.concatenate([np.diff(each) for each in signals]))) == 0.0:
        return longest_s
    bends = np.abs(np.concatenate([np.diff(each, 5) for each in signals])) / np.sqrt(252.0)
    noise = float(np.sqrt(np.mean(bends**2)) if derivative else np.median(bends) / MEDIAN)
    shortest, step_s = min(len(each) for each in signals), 1.0 / sampling_rate_hz
    lengths, length = [], window_length(sampling_rate_hz, longest_s, order)
    while length >= window_length(sampling_rate_hz, 0.0, order + 1):
        lengths.append(length)
        length = 2 * (length // 4) + 1
    chosen = 0
    samples = sum(map(len, signals))
    shorter: list[tuple[Sequence[Array], float]] = [] if derivative else [(signals, WORSE * noise**2)]
    for length in reversed([each for each in lengths if 2 * each <= shortest]):
        told = length, order, derivative, step_s
        found = [savgol_filter(each, *told) for each in signals]
        inner = slice(length // 2, -(length // 2))  # at the ends, whole windows look to one side
        apart = [[(one - other)[inner] for one, other in zip(found, own, strict=True)] for own, _ in shorter]
        if any(np.mean(np.concatenate(d) ** 2) > own[1] for d, own in zip(apart, shorter, strict=True)):
            break
        chosen, gains = length, savgol_coeffs(*told[:3], delta=step_s)
        chance = ERRORS * np.sqrt(2.0 * length / samples)
        shorter.append((found, (WORSE + chance) * noise**2 * float(gains @ gains)))
    return (chosen - 1) * step_s if chosen else 0.0


def window_samples(sampling_rate_hz: float, window_s: float) -> int:
    """Return the odd number of samples nearest to a window's length."""
    return 2 * int(window_s * sampling_rate_hz / 2.0) + 1


def window_length(sampling_rate_hz: float, window_s: float, order: int) -> int:
    """Return the odd number of samples nearest to a window's length that still holds a polynomial of that order."""
    return max(window_samples(sampling_rate_hz, window_s), order + 1 + order % 2)


def smooth(signal: Array, step_s: float, width_s: float) -> Array:
    """Return a signal, (T, K), with less noise and no delay: local cubics (Savitzky and Golay; see `differentiate`).

    Noise of an input passes into what is simulated from it; left there, every effect that blurs would seem to help. A
    signal shorter than the width, s, comes back as it is.
    """
    from scipy.signal import savgol_filter

    window = 2 * max(round(0.5 * width_s / step_s), 2) + 1
    return signal if len(signal) < window else np.asarray(savgol_filter(signal, window, 3, axis=0))


def follow(signal: Array, drive: Array, step_s: float) -> Array:
    """Return one or two lags of a drive that explain most of a signal, (T, K): the best of a grid, refined about it.

    Smoothing rounds the corners that steps of a drive make. What the lags leave has none: it may be smoothed alone.
    """
    from scipy.signal import lfilter

    if np.ptp(drive) == 0.0:
        return np.zeros_like(signal)
    centred, best, least = signal - signal.mean(), np.zeros_like(signal), np.inf
    at = (0.0, 0, 0.0)
    grid = [(np.log2(tau_s), round(late_s / step_s), 0.0) for tau_s in LAGS_S for late_s in DELAYS_S]
    for octaves in (*REFINED_OCTAVES, 0.0):
        for log_tau, late, second in dict.fromkeys(grid):
            lagged = drive[np.clip(np.arange(len(drive)) - late, 0, None)]
            for tau_s in [2.0**log_tau * share for share in (1.0, second) if share > 0.0]:
                kept = np.exp(-step_s / tau_s)
                lagged = lfilter([0.0, 1.0 - kept], [1.0, -kept], lagged, axis=0, zi=lagged[None, 0])[0]
            lagged = lagged - lagged.mean()
            size = float((lagged**2).sum())
            told = lagged * (float((lagged * centred).sum()) / size if size > 0.0 else 0.0)
            left = float(((centred - told) ** 2).sum())
            if left < least:
                best, least, at = told, left, (log_tau, late, second)
        few = max(round(octaves * DELAYS_S[1] / step_s), 1)
        grid = [
            (at[0] + up, max(at[1] + on, 0), second)
            for up in (-octaves, 0.0, octaves)
            for on in (-few, 0, few)
            for second in {max(at[2] + octaves * more, 0.0) for more in (-0.5, 0.0, 0.5)}
        ]
    return best


def decimate(signal: Array, factor: int, held: bool = False) -> Array:
    """Return every `factor`-th sample of a signal (T, K), from the first, of its mean over triangles around them.

    So nothing is late, and little is aliased. Of a signal that is `held` from each sample to the next the mean until
    the next one returned is taken instead. Ends are held.
    """
    from scipy.ndimage import convolve1d

    if factor == 1:
        return signal
    even = np.full(factor, 1.0 / factor)
    smooth = convolve1d(signal, np.convolve(even, even), axis=0, mode="nearest")
    if held:
        smooth = convolve1d(smooth, np.append(even, np.zeros(factor - 1)), axis=0, mode="nearest")
    return np.ascontiguousarray(smooth[::factor])


def white_share(factor: int) -> float:
    """Return the share of the variance of white noise that `decimate` leaves."""
    even = np.full(factor, 1.0 / factor)
    return float((np.convolve(even, even) ** 2).sum())
