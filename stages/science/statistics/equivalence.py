"""Equivalence of two methods or groups: two one-sided t-tests for a margin stated beforehand, and their power.

Values and a margin flow in; one `Equivalence` flows out. A difference that is not significant does not show equality;
a 90 % interval within the margin does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from stages.science.statistics.groups import scale_groups
from stages.science.statistics.paired import LARGEST_VALUE, ROUNDING, Array
from stages.science.statistics.power import (
    LARGEST_RATIO,
    SIGNIFICANCE,
    find_smallest_n,
    power_of_equivalence,
    power_of_paired_equivalence,
)

Verdict = Literal["equivalent", "different", "undecided", "undefined"]


@dataclass(frozen=True)
class Equivalence:
    """What two one-sided tests say of a difference and a margin.

    Parameters
    ----------
    n_first, n_second : int
        Values of each group; both are the number of pairs where values are paired.
    margin : float
        Largest difference, of either sign, that does not matter, in the unit of the data.
    difference, low, high : float
        Mean of first minus mean of second, with its 90 % interval, in the unit of the data.
    degrees_of_freedom : float
        Of the tests.
    p_value : float
        The larger of the two one-sided tests'.
    verdict : str
        ``equivalent`` where p < 0.05, that is where the 90 % interval lies within the margin; ``different`` where it
        lies beyond the margin; ``undecided`` where it crosses the margin; ``undefined`` without an interval.
    power : float
        Probability to declare equivalence if the true difference were zero and the true standard deviations those
        observed.
    n_needed : int or None
        Smallest number of values of each group, or of pairs, with power 0.8 under the same assumptions; None where
        there is no power or no number up to a million suffices.
    """

    n_first: int
    n_second: int
    margin: float
    difference: float
    low: float
    high: float
    degrees_of_freedom: float
    p_value: float
    verdict: Verdict
    power: float
    n_needed: int | None

    def tabulate(self) -> dict[str, float]:
        """Return the columns of a table's row that stand beside a test of difference."""
        needed = np.nan if self.n_needed is None else float(self.n_needed)
        return {"margin": self.margin, "p_tost": self.p_value, "power": self.power, "n_needed": needed}


def judge_equivalence(first: Array, second: Array, margin: float) -> Equivalence:
    """Test whether the means of two independent groups are equivalent, without assuming equal variances.

    Parameters
    ----------
    first, second : (n,) and (m,) float arrays
        Values of each group, in one unit.
    margin : float
        Largest difference of means that does not matter, in the unit of the data, positive.

    Returns
    -------
    Equivalence
        Interval, degrees of freedom, p-value and power are NaN with fewer than two values in a group, where each
        group's values are equal to rounding, or with a missing value (NaN).

    Raises
    ------
    ValueError
        When a group is not a vector or is empty, the margin is not positive or a number is absurdly large.

    Notes
    -----
    Schuirmann, A comparison of the two one-sided tests procedure and the power approach for assessing the equivalence
    of average bioavailability, J. Pharmacokinet. Biopharm. 15 (1987); degrees of freedom by Welch and Satterthwaite.
    """
    _check_margin(margin)
    moments = scale_groups(first, second)
    scaled = _scale(margin, moments.exponent)

    def power(n_first: int, n_second: int) -> float:
        return power_of_equivalence(scaled, *moments.sd, n_first, n_second)

    return _judge(
        moments.n, margin, moments.exponent, moments.difference, moments.error, moments.degrees_of_freedom, power
    )


def judge_paired_equivalence(first: Array, second: Array, margin: float) -> Equivalence:
    """Test whether two methods are equivalent on the same experiments.

    Parameters
    ----------
    first, second : (n,) float arrays
        A figure of merit of each method on each experiment, in one unit.
    margin : float
        Largest mean difference that does not matter, in the unit of the data, positive.

    Returns
    -------
    Equivalence
        Interval, degrees of freedom, p-value and power are NaN with fewer than two pairs, where all differences are
        equal to rounding, or with a missing value (NaN).

    Raises
    ------
    ValueError
        When the arrays do not pair up, the margin is not positive or a number is absurdly large.

    Notes
    -----
    Schuirmann (1987), as in `judge_equivalence`.
    """
    _check_margin(margin)
    first, second = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    if first.shape != second.shape:
        raise ValueError(f"expected two vectors of one length, got shapes {first.shape} and {second.shape}")
    exponent = scale_groups(first, second).exponent
    difference = np.ldexp(first, -exponent) - np.ldexp(second, -exponent)
    n = difference.size
    scaled = _scale(margin, exponent)
    sd = error = degrees = np.nan
    if n > 1 and np.ptp(difference) > ROUNDING:
        sd, degrees = float(difference.std(ddof=1)), n - 1.0
        error = sd / np.sqrt(n)

    def power(n_first: int, n_second: int) -> float:
        return power_of_paired_equivalence(scaled, sd, n_first)

    return _judge((n, n), margin, exponent, float(difference.mean()), error, degrees, power)


def _judge(
    n: tuple[int, int],
    margin: float,
    exponent: int,
    difference: float,
    error: float,
    degrees: float,
    power_at: Callable[[int, int], float],
) -> Equivalence:
    """Return the verdict on a difference and its error, both divided by a power of two; the margin is not."""
    from scipy import stats

    low = high = p_value = power = np.nan
    verdict: Verdict = "undefined"
    n_needed = None
    if np.isfinite(error):
        half = float(stats.t.ppf(1 - SIGNIFICANCE, degrees)) * error
        low, high = difference - half, difference + half
        scaled = _scale(margin, exponent)
        p_value = float(stats.t.sf((scaled - abs(difference)) / error, degrees))
        if p_value < SIGNIFICANCE:
            verdict = "equivalent"
        else:
            verdict = "different" if low > scaled or high < -scaled else "undecided"
        power = power_at(*n)
        n_needed = find_smallest_n(lambda each: power_at(each, each))
    return Equivalence(
        n_first=n[0],
        n_second=n[1],
        margin=float(margin),
        difference=float(np.ldexp(difference, exponent)),
        low=float(np.ldexp(low, exponent)),
        high=float(np.ldexp(high, exponent)),
        degrees_of_freedom=float(degrees),
        p_value=p_value,
        verdict=verdict,
        power=power,
        n_needed=n_needed,
    )


def _check_margin(margin: float) -> None:
    if not 0 < margin <= LARGEST_VALUE:
        raise ValueError(f"expected a margin above 0 and within {LARGEST_VALUE:g}, got {margin}")


def _scale(margin: float, exponent: int) -> float:
    with np.errstate(over="ignore"):
        return min(float(np.ldexp(margin, -exponent)), LARGEST_RATIO)
