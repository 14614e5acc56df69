"""Trials drawn again with replacement, and intervals over them."""

import numpy as np

from stages.science.signals.trajectories import Array


def resample(trials: int, draws: int, generator: np.random.Generator) -> Array:
    """Return how often each trial is drawn, (draws, trials) ndarray; rows sum to the number of trials."""
    return np.asarray(generator.multinomial(trials, np.full(trials, 1.0 / trials), size=draws), dtype=float)


def find_interval(drawn: Array, level: float) -> Array:
    """Return lower and upper end, (2, ...), of the central interval of a level over B resampled trials, (B, ...)."""
    tail = 0.5 * (1.0 - level)
    return np.asarray(np.quantile(drawn, [tail, 1.0 - tail], axis=0))
