"""Trials drawn again: the weights from which intervals come."""

from __future__ import annotations

import numpy as np

from stages.science.signals.trajectories import Array


def resample(trials: int, draws: int, generator: np.random.Generator) -> Array:
    """Return how often each trial is drawn, (draws, trials) ndarray; rows sum to the number of trials."""
    weights: Array = generator.multinomial(trials, np.full(trials, 1.0 / trials), size=draws).astype(float)
    return weights
