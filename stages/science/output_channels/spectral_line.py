"""A spectral line: an oscillation of one frequency in all trials, whatever its phase in each.

Residuals flow in; out flow the line's frequency, if there is one, and residuals without it. No measured signal predicts
a line, but it is no noise either: mains, a compressor, a loose part that rings.
"""

import numpy as np
from numpy.typing import NDArray

from stages.science.output_channels.output_channel import DetectionSettings
from stages.science.signals.trajectories import Array

HIGHEST = 0.95
"""Highest frequency of a line, over half the sampling rate; power is distributed differently at the edge."""
PADDING = 2
NEIGHBOURS = 80
"""Bins of the padded spectrum on either side of a frequency, from which its noise level is estimated."""
WIDEST = 2.0
"""Largest width of the neighbours on either side, over the lowest frequency of a line."""

LEAST_TAKEN = 0.01
"""Share of a trial's squares that a line takes away, in half of the trials: what is less is a trace of the motion."""


def find_line(residual: Array, present: NDArray[np.bool_], step_s: float, limits: DetectionSettings) -> float | None:
    """Return the frequency of a line in a residual, (T, K), which counts where present; Hz, or None.

    Mean power of K trials over the median around it, against the gamma distribution that it has under noise, for as
    many frequencies as trials have samples; Percival and Walden, Spectral Analysis for Physical Applications (1993),
    chapter 10.
    """
    from scipy.ndimage import median_filter
    from scipy.stats import gamma

    whole = np.flatnonzero(present.mean(axis=0) > 0.5)
    samples = len(residual)
    if not len(whole) or samples < 4 * NEIGHBOURS:
        return None
    if NEIGHBOURS / (PADDING * samples * step_s) > WIDEST * limits.lowest_line_hz:
        return None  # the spectrum's slope would look like a line
    kept = np.where(present, residual, 0.0)[:, whole]
    windowed = (kept - kept.mean(axis=0)) * np.hanning(samples)[:, None]
    power = np.abs(np.fft.rfft(windowed, PADDING * samples, axis=0)) ** 2
    frequency = np.fft.rfftfreq(PADDING * samples, step_s)
    sought = (frequency >= limits.lowest_line_hz) & (frequency <= HIGHEST * frequency[-1])
    if not sought.any():
        return None
    level = np.maximum(np.median(power[sought], axis=0), 1e-300)  # trials count alike, whatever wanders slowly in them
    mean = (power / level).mean(axis=1)
    usual = gamma.median(len(whole), scale=1.0 / len(whole))
    over = usual * mean / median_filter(mean, size=2 * NEIGHBOURS + 1, mode="mirror")
    peak = int(np.argmax(np.where(sought, over, 0.0)))
    by_chance = gamma.sf(over[peak], len(whole), scale=1.0 / len(whole)) * PADDING * samples / 2
    if by_chance >= limits.line_chance:
        return None
    left = remove_line(residual, present, step_s, float(frequency[peak]))[:, whole]
    taken = 1.0 - (left**2).sum(axis=0) / np.maximum((kept**2).sum(axis=0), 1e-300)
    return float(frequency[peak]) if np.median(taken) > LEAST_TAKEN else None


def remove_line(residual: Array, present: NDArray[np.bool_], step_s: float, frequency_hz: float) -> Array:
    """Return a residual, (T, K), without the oscillation of one frequency that fits each trial best.

    Its two weights are fitted to the trial itself, as its phase is its own; the residual is raised by what two weights
    take from noise.
    """
    angle = 2.0 * np.pi * frequency_hz * step_s * np.arange(len(residual))
    waves = np.column_stack([np.cos(angle), np.sin(angle)])
    left = np.where(present, residual, 0.0)
    for trial in np.flatnonzero(present.sum(axis=0) > 4):
        rows = present[:, trial]
        weights = np.linalg.lstsq(waves[rows], residual[rows, trial], rcond=None)[0]
        left[rows, trial] -= waves[rows] @ weights
        left[rows, trial] *= np.sqrt(rows.sum() / (rows.sum() - 2.0))
    return left
