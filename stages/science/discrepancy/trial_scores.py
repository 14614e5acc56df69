"""How well a model predicts trials left out of its fit: one log score, in which trials that jitter drown nothing.

Residuals of trials left out flow in; scores flow out. An offset and a gain of each trial are told apart from its shape,
and each of the three has a variance of its own, which is integrated out.
"""

from dataclasses import dataclass

import numpy as np

from stages.science.output_channels.output_channel import OutputChannel
from stages.science.output_channels.trial_noise import bound_jitter, count_effective, split_residual
from stages.science.signals.trajectories import Array


@dataclass(frozen=True)
class TrialScores:
    """Scores of models of one output, comparable with each other.

    `effective` is the number of independent samples of shape, `noise` the variance of a trial's offset and gain that
    the noise of its shape alone makes, and `jitter` the largest variance of them beside that.
    """

    output: OutputChannel
    effective: float
    noise: float
    jitter: float

    def score(self, residual: Array) -> float:
        """Return the log score of a model by its residual, (T, K), of trials left out; zero where not present.

        It is the log marginal likelihood of normal errors whose variance has Jeffreys' prior, up to what is the same
        for all models of the output. Offsets and gains have the most likely variance, up to the largest.
        """
        shape, offset, gain = split_residual(residual, self.output)
        samples, least = float(self.output.present.sum()), self.output.resolution**2
        score = -0.5 * self.effective * np.log((shape**2).sum() / samples + least + 1e-300)
        for each in (offset, gain) if self.output.jitters else ():
            found = float((each**2).mean())
            likely = min(found, self.jitter) + self.noise + 1e-300
            score -= 0.5 * len(each) * (np.log(likely) + (found + self.noise) / likely)
        return float(score)


def compare_by(output: OutputChannel, best: Array, largest_jitter: float) -> TrialScores:
    """Return how models of an output are scored.

    The residual of the best, (T, K), tells the number of independent samples. The largest offset or gain of a trial is
    over the root mean square of the measured signal.

    Notes
    -----
    Effective samples of a mean square: Bartlett 1946. Trials whose mean squares differ by more than these allow are
    fewer still: the dispersion of quasi-likelihood (McCullagh and Nelder, Generalized linear models, 1989).
    """
    shape = split_residual(best, output)[0]
    effective = count_effective(shape, output)
    count = np.maximum(output.present.sum(axis=0), 1)
    squares = (shape**2).sum(axis=0) / count
    mean = float(np.average(squares, weights=count))
    each = effective * count / count.sum()
    seen = each > 0.0
    trials, dispersion = int(seen.sum()), 1.0
    if mean > 0.0 and trials > 1:
        spread = 0.5 * each[seen] * (squares[seen] / mean - 1.0) ** 2
        dispersion = max(float(spread.sum()) / (trials - 1), 1.0)
    per_trial = max(effective / max(trials, 1), 1.0)
    return TrialScores(output, effective / dispersion, mean / per_trial, bound_jitter(output, largest_jitter) ** 2)
