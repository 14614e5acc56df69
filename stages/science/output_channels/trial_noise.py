"""Noise of an output whose trials each have an offset and a gain of their own, beside the noise of their shape.

Signals of trials flow in; their parts, and the signals over the standard deviations of these parts, flow out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from stages.science.output_channels.output_channel import OutputChannel
from stages.science.signals.trajectories import Array

LONGEST = 0.25
"""Longest lag of a correlation that is looked at, over the length of a trial."""
SMALLEST = 1e-6
"""Least standard deviation, over the channel's range."""
STILL = 1e-9
"""Root mean square about its mean, over that about zero, up to which a signal does not move but for rounding."""


@dataclass(frozen=True)
class TrialNoise:
    """Standard deviations of the parts of a trial's residual, in the channel's unit."""

    shape: float
    """As if samples were independent: larger than the shape's own where they are not."""
    offset: float
    gain: float
    """Of the part along the simulated signal, as a root mean square."""
    simulated: Array
    """The signal, (T, K), that a trial's gain multiplies: without the measured one's noise, which a gain would hide."""

    def take(self, trials: Sequence[int]) -> Self:
        """Return the noise of some of the trials, by position."""
        return replace(self, simulated=self.simulated[:, list(trials)])


def find_directions(simulated: Array, output: OutputChannel) -> Array:
    """Return the two directions of length one along which a trial's offset and gain move it, (K, 2, T).

    The second is along the simulated signal, (T, K), and zero where that stands still. Both are zero in an output whose
    trials have no offset or gain.
    """
    present = output.present
    if not output.jitters:
        return np.zeros((present.shape[1], 2, len(present)))
    still = present / np.sqrt(np.maximum(present.sum(axis=0), 1))
    moved = _centre(simulated, output)
    length, size = (np.sqrt((np.where(present, each, 0.0) ** 2).sum(axis=0)) for each in (moved, simulated))
    moved = np.where(length > STILL * size, moved / np.maximum(length, 1e-150), 0.0)
    return np.ascontiguousarray(np.stack([still, moved]).transpose(2, 0, 1))


def _centre(signal: Array, output: OutputChannel) -> Array:
    """Return a signal less its mean in each trial, (T, K); zero where not present."""
    mean = np.where(output.present, signal, 0.0).sum(axis=0) / np.maximum(output.present.sum(axis=0), 1)
    return np.where(output.present, signal - mean, 0.0)


def split_residual(residual: Array, output: OutputChannel) -> tuple[Array, Array, Array]:
    """Return the shape of each trial's residual, (T, K), its offset and its part along the simulated signal, (K,) each.

    The latter is told as a root mean square, in the channel's unit.
    """
    bare = np.where(output.present, residual, 0.0).T
    directions = find_directions(output.measured - residual, output)
    parts = np.matmul(directions, bare[:, :, None])
    shape: Array = (bare - (directions * parts).sum(axis=1)).T
    offset, gain = parts[:, :, 0].T / np.sqrt(np.maximum(output.present.sum(axis=0), 1))
    return shape, offset, np.abs(gain)


def bound_jitter(output: OutputChannel, largest: float) -> float:
    """Return the largest offset or gain of a trial, as a root mean square: a share of the measured signal's."""
    count = np.maximum(output.present.sum(axis=0), 1)
    return largest * float(np.sqrt(((_centre(output.measured, output) ** 2).sum(axis=0) / count).mean()))


def estimate_trial_noise(residual: Array, output: OutputChannel, largest: float) -> TrialNoise:
    """Return the noise of which a residual, (T, K), would be a sample, its jitter no larger than `bound_jitter`'s."""
    shape, offset, gain = split_residual(residual, output)
    least, most = SMALLEST * output.range, bound_jitter(output, largest)
    offset_sd, gain_sd = (min(max(float(np.sqrt((each**2).mean())), least), most) for each in (offset, gain))
    spread = float(np.sqrt((shape**2).sum() / max(count_effective(shape, output), 1.0)))
    return TrialNoise(max(spread, least), offset_sd, gain_sd, output.measured - residual)


def count_effective(shape: Array, output: OutputChannel) -> float:
    """Return the number of independent samples in a mean square of a signal, (T, K), by its correlation.

    Source: Bartlett, Journal of the Royal Statistical Society Supplement 8 (1946).
    """
    samples = float(output.present.sum())
    size = float((shape**2).sum())
    if size <= 0.0:
        return samples
    padded = np.zeros((2 * len(shape), shape.shape[1]))
    padded[: len(shape)] = shape
    spectrum = np.abs(np.fft.rfft(padded, axis=0)) ** 2
    correlation = np.fft.irfft(spectrum.sum(axis=1))[: max(int(LONGEST * len(shape)), 2)] / size
    return samples / (1.0 + 2.0 * float((correlation[1:] ** 2).sum()))
