"""Whether repeated experiments choose the same few options: dispersion of the counts, against choosing at random.

What each experiment chose flows in; one `Concentration` flows out.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stages.science.statistics.paired import Array

Integers = NDArray[np.int64]

LARGEST_BLOCK = 2_000_000
"""Numbers that are drawn at a time, 16 MB."""

ROUNDING = 1e-9
"""Share of a dispersion by which sums of the same counts may differ."""


@dataclass(frozen=True)
class Choices:
    """What one experiment chose, and from what.

    Parameters
    ----------
    chosen : (K,) int array
        Options, 0 to R - 1.
    available : (A,) int array
        Options that the experiment could choose from at its beginning.
    again : bool
        Whether an option that was chosen could be chosen again.
    """

    chosen: Integers
    available: Integers
    again: bool

    def expect(self, options: int) -> Array:
        """Return how often each option is chosen at random, on average, (R,)."""
        expected = np.zeros(options)
        expected[self.available] = self.chosen.size / self.available.size
        return expected

    def draw(self, draws: int, options: int, generator: np.random.Generator) -> Integers:
        """Return how often each option is chosen at random, (draws, R)."""
        counts = np.zeros((draws, options), dtype=np.int64)
        size, count = self.available.size, self.chosen.size
        if self.again:
            counts[:, self.available] = generator.multinomial(count, np.full(size, 1 / size), size=draws)
        elif count == size:
            counts[:, self.available] = 1
        elif count:
            first = np.argpartition(generator.random((draws, size)), count, axis=1)[:, :count]
            counts[np.arange(draws)[:, None], self.available[first]] = 1
        return counts


@dataclass(frozen=True)
class Concentration:
    """What experiments say of choosing alike, as columns of a table.

    Parameters
    ----------
    n : int
        Experiments.
    dispersion : float
        Sum over options of (count - expected)^2 / expected, as Pearson's, over all experiments together.
    expected, low, high : float
        Its mean and the ends of its central 95 % where every experiment chooses at random.
    effect : float
        Dispersion over its mean at random; NaN where that is zero.
    p : float
        One-sided, Monte Carlo: (1 + draws at least as dispersed) / (1 + draws).
    """

    n: int
    dispersion: float
    expected: float
    low: float
    high: float
    effect: float
    p: float


def judge_concentration(
    experiments: Sequence[Choices], options: int, draws: int, generator: np.random.Generator
) -> Concentration:
    """Test whether experiments choose the same options more often than each one's choosing at random would.

    The experiment is the unit: choices within one are drawn as it could make them, without those that it could not
    choose and, where none may be chosen again, without replacement.

    Parameters
    ----------
    experiments : sequence of Choices
        One for each experiment.
    options : int
        R.
    draws : int
        Of all experiments together.
    generator : Generator
        For them.

    Notes
    -----
    The p-value counts the data among the draws, so that it is valid for any number of them and never zero: Phipson and
    Smyth, Permutation p-values should never be zero, Stat. Appl. Genet. Mol. Biol. 9 (2010).
    """
    expected = np.sum([each.expect(options) for each in experiments], axis=0)
    found = np.bincount(np.concatenate([each.chosen for each in experiments]), minlength=options)
    dispersion = float(_disperse(found, expected))
    blocks, block = [], max(1, LARGEST_BLOCK // options)
    for start in range(0, draws, block):
        counts = np.zeros((min(block, draws - start), options), dtype=np.int64)
        for each in experiments:
            counts += each.draw(len(counts), options, generator)
        blocks.append(_disperse(counts, expected))
    at_random = np.concatenate(blocks)
    mean = float(at_random.mean())
    low, high = np.quantile(at_random, [0.025, 0.975])
    as_far = int((at_random >= dispersion * (1 - ROUNDING)).sum())
    effect = dispersion / mean if mean else np.nan
    return Concentration(
        len(experiments), dispersion, mean, float(low), float(high), effect, (1 + as_far) / (1 + draws)
    )


def _disperse(counts: NDArray[np.integer], expected: Array) -> Array:
    """Return the dispersion of (..., R) counts about their expected values, (R,); options never available add none."""
    possible = expected > 0
    difference = counts[..., possible] - expected[possible]
    return np.asarray((difference**2 / expected[possible]).sum(axis=-1))
