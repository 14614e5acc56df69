"""Equivalence of two methods or groups: two one-sided t-tests for a margin stated beforehand, and their power.

Values and a margin flow in; one `Equivalence` flows out. A difference that is not significant does not show equality;
a 90 % interval within the margin does.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stages.science.statistics.groups import scale_groups
from stages.science.statistics.paired import LARGEST_VALUE, ROUNDING, Array, find_exponent, read_pairs
from stages.science.statistics.power import (
    LARGEST_RATIO,
    find_smallest_n,
    power_of_equivalence,
    power_of_paired_equivalence,
)


@dataclass(frozen=True)
class Equivalence:
    """What two one-sided tests say of a difference and a margin, as columns of a table.

    Parameters
    ----------
    margin : float
        Largest difference, of either sign, that does not matter, in the unit of the data.
    p_tost : float
        The larger of the two one-sided tests'.
    power : float
        Probability to declare equivalence if the true difference were zero and the true standard deviations those
        observed.
    n_needed : float
        Smallest number of values of each group, or of pairs, with power 0.8 under the same assumptions; NaN where
        there is no power or no number up to a million suffices.
    """

    margin: float
    p_tost: float
    power: float
    n_needed: float


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
        All but the margin is NaN with fewer than two values in a group, where each group's values are equal to
        rounding, or with a missing value (NaN).

    Raises
    ------
    ValueError
        When a group is not a vector or is empty, the margin is not positive or a number is absurdly large.

    Notes
    -----
    Schuirmann, A comparison of the two one-sided tests procedure and the power approach for assessing the equivalence
    of average bioavailability, J. Pharmacokinet. Biopharm. 15 (1987); degrees of freedom by Welch and Satterthwaite.
    """
    moments = scale_groups(first, second)
    found = moments.difference, moments.error, moments.degrees_of_freedom
    return _judge(
        margin, moments.exponent, *found, moments.n, lambda scaled, *n: power_of_equivalence(scaled, *moments.sd, *n)
    )


def judge_paired_equivalence(first: Array, second: Array, margin: float) -> Equivalence:
    """Test whether two methods are equivalent on the same experiments, as `judge_equivalence` does of groups.

    Parameters
    ----------
    first, second : (n,) float arrays
        A figure of merit of each method on each experiment, in one unit.
    margin : float
        Largest mean difference that does not matter, in the unit of the data, positive.

    Raises
    ------
    ValueError
        When the arrays do not pair up, the margin is not positive or a number is absurdly large.
    """
    first, second = read_pairs(first, second)
    exponent = find_exponent(first, second)
    difference = np.ldexp(first, -exponent) - np.ldexp(second, -exponent)
    n = difference.size
    sd = error = np.nan
    if n > 1 and np.ptp(difference) > ROUNDING:
        sd = float(difference.std(ddof=1))
        error = sd / np.sqrt(n)
    found = float(difference.mean()), error, n - 1.0
    return _judge(margin, exponent, *found, (n, n), lambda scaled, n, _: power_of_paired_equivalence(scaled, sd, n))


def _judge(
    margin: float,
    exponent: int,
    difference: float,
    error: float,
    degrees: float,
    n: tuple[int, int],
    power_at: Callable[[float, int, int], float],
) -> Equivalence:
    """Judge a difference and its error, both divided by a power of two; the margin is not."""
    from scipy import stats

    if not 0 < margin <= LARGEST_VALUE:
        raise ValueError(f"expected a margin above 0 and within {LARGEST_VALUE:g}, got {margin}")
    p_tost = power = n_needed = np.nan
    if np.isfinite(error):
        with np.errstate(over="ignore"):
            scaled = min(float(np.ldexp(margin, -exponent)), LARGEST_RATIO)
        p_tost = float(stats.t.sf((scaled - abs(difference)) / error, degrees))
        power = power_at(scaled, *n)
        n_needed = find_smallest_n(lambda each: power_at(scaled, each, each))
    return Equivalence(float(margin), p_tost, power, n_needed)
