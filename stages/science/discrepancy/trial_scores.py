"""How well a model predicts trials left out of its fit: one log score, in which trials that jitter drown nothing.

Residuals of trials left out flow in; scores flow out. An offset and a gain of each trial are told apart from its shape,
and each of the three has a variance of its own, which is integrated out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stages.science.output_channels.families import keep_shape
from stages.science.output_channels.output_channel import OutputChannel
from stages.science.signals.trajectories import Array

LONGEST = 0.25
"""Longest lag of a correlation that is looked at, over the length of a trial."""


@dataclass(frozen=True)
class TrialScores:
    """Scores of models of one output, comparable with each other.

    Parameters
    ----------
    output : OutputChannel
        What was predicted.
    effective : float
        Number of independent samples of shape.
    noise : float
        Variance of a trial's offset and gain that the noise of its shape alone makes.
    """

    output: OutputChannel
    effective: float
    noise: float

    def score(self, residual: Array) -> float:
        """Return the log score of a model.

        Parameters
        ----------
        residual : (T, K) ndarray
            Of trials left out of its fit; zero where not present.

        Notes
        -----
        The log marginal likelihood of normal errors whose variance has Jeffreys' prior, up to what is the same for all
        models of the output.
        """
        shape, offset, gain = split_residual(residual, self.output)
        samples, least = float(self.output.present.sum()), self.output.resolution**2
        score = -0.5 * self.effective * np.log((shape**2).sum() / samples + least + 1e-300)
        for each in (offset, gain) if self.output.jitters else ():
            score -= 0.5 * len(each) * np.log((each**2).mean() + self.noise + 1e-300)
        return float(score)


def split_residual(residual: Array, output: OutputChannel) -> tuple[Array, Array, Array]:
    """Return the shape of each trial's residual, (T, K), its offset and its part along the measured signal, (K,) each.

    The latter is told as a root mean square, in the channel's unit.
    """
    shape = keep_shape(residual[:, :, None], output)[:, :, 0]
    present = output.present
    count = np.maximum(present.sum(axis=0), 1)
    offset = np.where(present, residual, 0.0).sum(axis=0) / count
    along = np.where(present, residual - offset, 0.0) - shape
    return shape, offset, np.sqrt((along**2).sum(axis=0) / count)


def compare_by(output: OutputChannel, best: Array) -> TrialScores:
    """Return how models of an output are scored.

    Parameters
    ----------
    output : OutputChannel
        What they predict.
    best : (T, K) ndarray
        Residual of the best of them, by which the number of independent samples is told.

    Notes
    -----
    Effective samples of a mean square: Bartlett 1946. Trials whose mean squares differ by more than these allow are
    fewer still: the dispersion of quasi-likelihood (McCullagh and Nelder, Generalized linear models, 1989).
    """
    shape = split_residual(best, output)[0]
    effective = _count_effective(shape, output)
    count = np.maximum(output.present.sum(axis=0), 1)
    squares = (shape**2).sum(axis=0) / count
    mean = float(np.average(squares, weights=count))
    each = effective * count / count.sum()
    seen = each > 0.0
    dispersion = 1.0
    if mean > 0.0 and seen.sum() > 1:
        spread = 0.5 * each[seen] * (squares[seen] / mean - 1.0) ** 2
        dispersion = max(float(spread.sum()) / (int(seen.sum()) - 1), 1.0)
    per_trial = max(effective / max(int(seen.sum()), 1), 1.0)
    return TrialScores(output, effective / dispersion, mean / per_trial)


def _count_effective(shape: Array, output: OutputChannel) -> float:
    samples = float(output.present.sum())
    size = float((shape**2).sum())
    if size <= 0.0:
        return samples
    padded = np.zeros((2 * len(shape), shape.shape[1]))
    padded[: len(shape)] = shape
    spectrum = np.abs(np.fft.rfft(padded, axis=0)) ** 2
    correlation = np.fft.irfft(spectrum.sum(axis=1))[: max(int(LONGEST * len(shape)), 2)] / size
    return samples / (1.0 + 2.0 * float((correlation[1:] ** 2).sum()))
