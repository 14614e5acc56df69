"""Noise of an output whose trials each have an offset and a gain of their own, beside the noise of their shape.

Signals of trials flow in; their parts, and the signals over the standard deviations of these parts, flow out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stages.science.output_channels.output_channel import OutputChannel
from stages.science.signals.trajectories import Array

LONGEST = 0.25
"""Longest lag of a correlation that is looked at, over the length of a trial."""
SMALLEST = 1e-6
"""Least standard deviation, over the channel's range."""


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

    def take(self, trials: Sequence[int]) -> TrialNoise:
        """Return the noise of some of the trials, by position."""
        return replace(self, simulated=self.simulated[:, list(trials)])

    def multiply(self, signals: Array, output: OutputChannel) -> Array:
        """Return sums of products of signals, (T, K, Q), over each trial's samples, each part over its variance.

        The signals are zero where not present; the sums are (K, Q, Q).
        """
        shape, offset, along = multiply_parts(signals, self.simulated, output)
        count = np.maximum(output.present.sum(axis=0), 1)[:, None, None]
        varied = (self.shape**2 + count * each**2 for each in (self.offset, self.gain))
        white: Array = shape / self.shape**2 + offset / next(varied) + along / next(varied)
        return white


def multiply_parts(signals: Array, simulated: Array, output: OutputChannel) -> tuple[Array, Array, Array]:
    """Return sums of products of signals' shapes, offsets and parts along a simulated signal, (K, Q, Q) each.

    The parts are those of `split_signals`, which are orthogonal, so that only the sums of the whole signals, (T, K, Q),
    are taken sample by sample. The signals are zero where not present.
    """
    by_trial = np.ascontiguousarray(signals.transpose(1, 0, 2))
    whole = by_trial.transpose(0, 2, 1) @ by_trial
    if not output.jitters:
        return whole, np.zeros_like(whole), np.zeros_like(whole)
    moved = _centre(simulated, output).T
    size = np.maximum((moved**2).sum(axis=1), 1e-300)[:, None]
    moments = (
        by_trial.sum(axis=1) / np.sqrt(np.maximum(output.present.sum(axis=0), 1))[:, None],
        (moved[:, None, :] @ by_trial)[:, 0, :] / np.sqrt(size),
    )
    offset, along = (each[:, :, None] * each[:, None, :] for each in moments)
    return whole - offset - along, offset, along


def split_signals(signals: Array, simulated: Array, output: OutputChannel) -> tuple[Array, Array, Array]:
    """Return signals' shape in each trial, (T, K, Q), their offset, (K, Q), and the part along a simulated one, (T, K).

    All is shape in an output whose trials have no offset or gain of their own.
    """
    present = output.present[:, :, None]
    bare = np.where(present, signals, 0.0)
    if not output.jitters:
        return bare, np.zeros(bare.shape[1:]), np.zeros_like(bare)
    moved = _centre(simulated, output)
    offset = bare.sum(axis=0) / np.maximum(present.sum(axis=0), 1)
    moving = np.where(present, bare - offset, 0.0)
    share = np.einsum("tk,tkq->kq", moved, moving) / np.maximum((moved**2).sum(axis=0), 1e-300)[:, None]
    along = moved[:, :, None] * share
    return moving - along, offset, along


def _centre(signal: Array, output: OutputChannel) -> Array:
    """Return a signal less its mean in each trial, (T, K); zero where not present."""
    mean = np.where(output.present, signal, 0.0).sum(axis=0) / np.maximum(output.present.sum(axis=0), 1)
    return np.where(output.present, signal - mean, 0.0)


def split_residual(residual: Array, output: OutputChannel) -> tuple[Array, Array, Array]:
    """Return the shape of each trial's residual, (T, K), its offset and its part along the simulated signal, (K,) each.

    The latter is told as a root mean square, in the channel's unit.
    """
    shape, offset, along = split_signals(residual[:, :, None], output.measured - residual, output)
    count = np.maximum(output.present.sum(axis=0), 1)
    return shape[:, :, 0], offset[:, 0], np.sqrt((along[:, :, 0] ** 2).sum(axis=0) / count)


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
