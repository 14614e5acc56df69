"""Power of equivalence tests of normal data, by quadrature.

A design (standard deviations, numbers of values, a true difference) flows in; a probability or a number of values
comes out. A mean difference and its estimated standard error are independent, so a probability given the error is
averaged over the error's distribution. That is exact for normal data, also for Welch's test, whose degrees of freedom
vary from sample to sample.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np

from stages.science.statistics.paired import Array

SIGNIFICANCE = 0.05
"""Level of every test."""

WANTED_POWER = 0.8
"""Power that a number of values is asked for."""

LARGEST_N = 1_000_000
"""Numbers of values that are searched."""

MOST_VALUES = 1_000_000_000
"""Numbers of values at which powers keep five digits."""

NODES = 128
NEGLIGIBLE = 1e-17
"""Probability of each tail that the quadrature leaves out."""

LARGEST_RATIO = 1e200
"""Differences and margins beyond it, in units of a standard deviation, are taken for it."""


class _Spread(NamedTuple):
    """Distribution of the half-width that a test compares a difference with: slope times chi.

    Parameters
    ----------
    error : float
        True standard error of the difference, in the unit of the standard deviations.
    slope, weight : (B,) ndarray
        Half-width per chi and probability, for each ratio of estimated variances.
    degrees : int
        Degrees of freedom of chi.
    """

    error: float
    slope: Array
    weight: Array
    degrees: int


def power_of_paired_equivalence(margin: float, sd: float, n: int, difference: float = 0.0) -> float:
    """Return the probability that paired differences are declared equivalent to zero at 5 %.

    Parameters
    ----------
    margin : float
        Largest difference, of either sign, that does not matter.
    sd : float
        Standard deviation of the differences, in the same unit.
    n : int
        Pairs.
    difference : float
        True mean of the differences, in the same unit.

    Returns
    -------
    float
        Power of the two one-sided tests.

    Raises
    ------
    ValueError
        When pairs are fewer than two or over 1e9, the standard deviation is not positive or a number is not finite.

    Notes
    -----
    Phillips, Power of the two one-sided tests procedure in bioequivalence, J. Pharmacokinet. Biopharm. 18 (1990):
    Owen's Q function, which the quadrature evaluates.
    """
    _check(difference, margin, (sd,), (n,))
    return _enclose(float(margin) / float(sd), float(difference) / float(sd), _spread_of_pairs(n, SIGNIFICANCE))


def power_of_equivalence(
    margin: float, sd_first: float, sd_second: float, n_first: int, n_second: int, difference: float = 0.0
) -> float:
    """Return the probability that two groups are declared equivalent at 5 %, with Welch's degrees of freedom.

    Parameters
    ----------
    margin : float
        Largest difference of means, of either sign, that does not matter.
    sd_first, sd_second : float
        Standard deviation of each group, in the same unit; one of them may be zero.
    n_first, n_second : int
        Values of each group.
    difference : float
        True difference of the means, in the same unit.

    Returns
    -------
    float
        Power of the two one-sided tests.

    Raises
    ------
    ValueError
        When a group has fewer than two values or over 1e9, neither has a spread or a number is not finite.
    """
    _check(difference, margin, (sd_first, sd_second), (n_first, n_second))
    unit = float(max(sd_first, sd_second))
    spread = _spread_of_groups((sd_first / unit, sd_second / unit), (n_first, n_second), SIGNIFICANCE)
    return _enclose(float(margin) / unit, float(difference) / unit, spread)


def find_smallest_n(power_at: Callable[[int], float], wanted: float = WANTED_POWER) -> int | None:
    """Return the smallest n of at least 2 whose power is as wanted; None where more than `LARGEST_N` are needed.

    Parameters
    ----------
    power_at : callable
        Power by n, not falling.
    wanted : float
        Between 0 and 1.
    """
    low, high = 1, 2
    while power_at(high) < wanted:
        if high == LARGEST_N:
            return None
        low, high = high, min(2 * high, LARGEST_N)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if power_at(middle) >= wanted else (middle, high)
    return high


def _check(difference: float, margin: float, sds: tuple[float, ...], ns: tuple[int, ...]) -> None:
    if not np.isfinite([difference, margin, *sds]).all() or min(sds) < 0 or max(sds) == 0 or margin < 0:
        raise ValueError(
            "expected a finite difference, a margin of at least 0 and a positive standard deviation, "
            f"got {difference}, {margin} and {', '.join(map(str, sds))}"
        )
    if any(n % 1 != 0 for n in ns) or not 2 <= min(ns) <= max(ns) <= MOST_VALUES:
        raise ValueError(f"expected 2 to {MOST_VALUES} values, got {', '.join(map(str, ns))}")


@cache
def _legendre() -> tuple[Array, Array]:
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    return (nodes + 1) / 2, weights / 2


def _spread_of_pairs(n: int, tail: float) -> _Spread:
    """Return the spread of the half-width of paired differences whose standard deviation is 1."""
    from scipy import special

    error = 1 / np.sqrt(n)
    slope = error * special.stdtrit(n - 1, 1 - tail) / np.sqrt(n - 1)
    return _Spread(float(error), np.array([slope]), np.ones(1), n - 1)


def _spread_of_groups(sds: tuple[float, float], ns: tuple[int, int], tail: float) -> _Spread:
    """Return the spread of Welch's half-width.

    The sum of the chi-squares of both variances and the share of one in it are independent, the share beta
    distributed; Welch's degrees of freedom depend on the share alone.
    """
    from scipy import special

    first, second = ns[0] - 1, ns[1] - 1
    # as sin^2 of an angle, a share has a smooth density for every n
    low, high = (
        np.arcsin(np.sqrt(special.betaincinv(first / 2, second / 2, NEGLIGIBLE))),
        np.arccos(np.sqrt(special.betaincinv(second / 2, first / 2, NEGLIGIBLE))),
    )
    nodes, weights = _legendre()
    angle = low + (high - low) * nodes
    log_density = (first - 1) * np.log(np.sin(angle)) + (second - 1) * np.log(np.cos(angle))
    weight = weights * np.exp(log_density - log_density.max())
    of_first = np.sin(angle) ** 2 * sds[0] ** 2 / (ns[0] * first)
    of_second = np.cos(angle) ** 2 * sds[1] ** 2 / (ns[1] * second)
    total = of_first + of_second
    degrees = 1 / ((of_first / total) ** 2 / first + (of_second / total) ** 2 / second)
    error = np.sqrt(sds[0] ** 2 / ns[0] + sds[1] ** 2 / ns[1])
    slope = special.stdtrit(degrees, 1 - tail) * np.sqrt(total)
    return _Spread(float(error), slope, weight / weight.sum(), first + second)


def _chi_rule(degrees: int, upper: Array) -> tuple[Array, Array]:
    """Return (B, N) nodes and probabilities of chi up to each of (B,) values."""
    from scipy import special

    low = np.sqrt(2 * special.gammaincinv(degrees / 2, NEGLIGIBLE))
    high = np.sqrt(2 * special.gammainccinv(degrees / 2, NEGLIGIBLE))
    nodes, weights = _legendre()
    width = np.clip(upper, low, high)[:, None] - low
    chi = low + width * nodes
    log_density = (degrees - 1) * np.log(chi) - chi**2 / 2 - (degrees / 2 - 1) * np.log(2)
    return chi, width * weights * np.exp(log_density - special.gammaln(degrees / 2))


def _enclose(margin: float, difference: float, spread: _Spread) -> float:
    from scipy import special

    margin, difference = _limit(margin), _limit(difference)
    chi, weight = _chi_rule(spread.degrees, margin / spread.slope)
    half = spread.slope[:, None] * chi
    # the margin less the difference first, as both may be far larger than the rest
    below, above = special.ndtr(np.stack([half - (margin + difference), (margin - difference) - half]) / spread.error)
    inside = np.maximum(above - below, 0.0)
    return min(float(spread.weight @ (weight * inside).sum(axis=1)), 1.0)


def _limit(ratio: float) -> float:
    return min(max(float(ratio), -LARGEST_RATIO), LARGEST_RATIO)
