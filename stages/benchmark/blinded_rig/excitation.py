"""Pressure commands: smooth and natural in half of the trials; steps, ramps and holds in the others.

Flows in: a generator. Flows out: commands (4, trials, samples) at the sampling rate, kPa gauge.
"""

import numpy as np

from stages.benchmark.blinded_rig.machine import DATA_SHEET, MUSCLES, Array

LOWEST_KPA = (15.0, 120.0)
CEILING_KPA = {"agonist": (250.0, 500.0), "antagonist": (300.0, 600.0)}


def command_pressures(rng: np.random.Generator, trials: int, time_s: Array) -> Array:
    """Commands (4, trials, samples), kPa; ``time_s`` counts from the start of the trial."""
    abrupt = (steps, steps, ramps, smooth)
    natural = rng.permutation(np.arange(trials) % 2 == 0)
    commands = np.empty((len(MUSCLES), trials, time_s.size))
    for index, muscle in enumerate(MUSCLES):
        lowest, highest = CEILING_KPA[DATA_SHEET[muscle].role]
        for trial in range(trials):
            low, high = rng.uniform(*LOWEST_KPA), rng.uniform(lowest, highest)
            maker = smooth if natural[trial] else abrupt[rng.integers(len(abrupt))]
            commands[index, trial] = low + (high - low) * maker(rng, time_s)
    return commands


def smooth(rng: np.random.Generator, time_s: Array) -> Array:
    """Two slow waves and a faster one, between 0 and 1."""
    rates = np.array([rng.uniform(0.1, 0.4), rng.uniform(0.4, 0.8), rng.uniform(0.7, 1.3)])
    weights = rng.uniform(0.3, 1.0, 3) * np.array([1.0, 0.6, 0.35])
    waves = np.sin(2.0 * np.pi * rates[:, None] * time_s + rng.uniform(0.0, 2.0 * np.pi, (3, 1)))
    total = weights @ waves
    return (total - total.min()) / (total.max() - total.min())


def steps(rng: np.random.Generator, time_s: Array) -> Array:
    """Levels held for 0.3 to 1.4 s."""
    edges = np.cumsum(rng.uniform(0.3, 1.4, 16))
    return rng.uniform(0.0, 1.0, 17)[np.searchsorted(edges, time_s, side="right")]


def ramps(rng: np.random.Generator, time_s: Array) -> Array:
    """Straight lines from level to level, holding some."""
    knots = np.concatenate([[0.0], np.cumsum(rng.uniform(0.15, 1.2, 32))])
    levels = rng.uniform(0.0, 1.0, knots.size)
    held = rng.random(knots.size - 1) < 0.4
    levels[1:][held] = levels[:-1][held]
    return np.interp(time_s, knots, levels)
