"""Power of equivalence tests of normal data, by quadrature.

A design (margin, standard deviations, numbers of values) flows in; a probability or a number of values comes out. A
mean difference and its estimated standard error are independent, so a probability given the error is averaged over the
error's distribution. That is exact for normal data, also for Welch's test, whose degrees of freedom vary from sample to
sample.
"""

from bisect import bisect_left
from collections.abc import Callable
from functools import cache

import numpy as np

from stages.science.statistics.paired import Array

SIGNIFICANCE = 0.05
"""Level of every test."""

WANTED_POWER = 0.8
"""Power that a number of values is asked for."""

LARGEST_N = 1_000_000
"""Numbers of values that are searched."""

NODES = 128
NEGLIGIBLE = 1e-17
"""Probability of each tail that the quadrature leaves out."""

LARGEST_RATIO = 1e200
"""Margins beyond it, in units of a standard deviation, are taken for it."""


def power_of_paired_equivalence(margin: float, sd: float, n: int) -> float:
    """Return the probability that paired differences whose true mean is zero are declared equivalent to it at 5 %.

    Parameters
    ----------
    margin : float
        Largest difference, of either sign, that does not matter.
    sd : float
        Standard deviation of the differences, in the same unit, positive.
    n : int
        Pairs, at least two.
    """
    from scipy import special

    error = 1 / np.sqrt(n)
    slope = error * special.stdtrit(n - 1, 1 - SIGNIFICANCE) / np.sqrt(n - 1)
    return _enclose(float(margin) / float(sd), float(error), np.array([slope]), np.ones(1), n - 1)


def power_of_equivalence(margin: float, sd_first: float, sd_second: float, n_first: int, n_second: int) -> float:
    """Return the probability that two groups of one true mean are declared equivalent at 5 %, by Welch's test.

    The sum of the chi-squares of both variances and the share of one in it are independent, the share beta
    distributed; Welch's degrees of freedom depend on the share alone.

    Parameters
    ----------
    margin : float
        Largest difference of means, of either sign, that does not matter.
    sd_first, sd_second : float
        Standard deviation of each group, in the same unit; one of them may be zero.
    n_first, n_second : int
        Values of each group, at least two.
    """
    from scipy import special

    unit = float(max(sd_first, sd_second))
    sds, first, second = (sd_first / unit, sd_second / unit), n_first - 1, n_second - 1
    # as sin^2 of an angle, a share has a smooth density for every n
    low = np.arcsin(np.sqrt(special.betaincinv(first / 2, second / 2, NEGLIGIBLE)))
    high = np.arccos(np.sqrt(special.betaincinv(second / 2, first / 2, NEGLIGIBLE)))
    nodes, weights = _legendre()
    angle = low + (high - low) * nodes
    log_density = (first - 1) * np.log(np.sin(angle)) + (second - 1) * np.log(np.cos(angle))
    weight = weights * np.exp(log_density - log_density.max())
    of_first = np.sin(angle) ** 2 * sds[0] ** 2 / (n_first * first)
    of_second = np.cos(angle) ** 2 * sds[1] ** 2 / (n_second * second)
    total = of_first + of_second
    degrees = 1 / ((of_first / total) ** 2 / first + (of_second / total) ** 2 / second)
    error = np.sqrt(sds[0] ** 2 / n_first + sds[1] ** 2 / n_second)
    slope = special.stdtrit(degrees, 1 - SIGNIFICANCE) * np.sqrt(total)
    return _enclose(float(margin) / unit, float(error), slope, weight / weight.sum(), first + second)


def find_smallest_n(power_at: Callable[[int], float]) -> float:
    """Return the smallest n of at least 2 whose power is `WANTED_POWER`; NaN where more than `LARGEST_N` are needed.

    Parameters
    ----------
    power_at : callable
        Power by n, not falling.
    """
    smallest = bisect_left(range(LARGEST_N + 1), True, lo=2, key=lambda n: power_at(n) >= WANTED_POWER)
    return float(smallest) if smallest <= LARGEST_N else np.nan


@cache
def _legendre() -> tuple[Array, Array]:
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    return (nodes + 1) / 2, weights / 2


def _enclose(margin: float, error: float, slope: Array, weight: Array, degrees: int) -> float:
    """Return how often a difference of true standard error `error` lies within the margin by its half-width.

    The half-width is a slope, (B,), of a probability, (B,), times chi.
    """
    from scipy import special

    margin = min(margin, LARGEST_RATIO)
    low = np.sqrt(2 * special.gammaincinv(degrees / 2, NEGLIGIBLE))
    high = np.sqrt(2 * special.gammainccinv(degrees / 2, NEGLIGIBLE))
    nodes, weights = _legendre()
    width = np.clip(margin / slope, low, high)[:, None] - low
    chi = low + width * nodes
    log_density = (degrees - 1) * np.log(chi) - chi**2 / 2 - (degrees / 2 - 1) * np.log(2)
    probability = width * weights * np.exp(log_density - special.gammaln(degrees / 2))
    half = slope[:, None] * chi
    below, above = special.ndtr(np.stack([half - margin, margin - half]) / error)
    inside = np.maximum(above - below, 0.0)
    return min(float(weight @ (probability * inside).sum(axis=1)), 1.0)
