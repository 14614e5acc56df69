"""Two independent groups: difference, interval, effect size and Welch's test.

One value per member of each group flows in; one `GroupComparison` flows out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stages.science.statistics.paired import LARGEST_VALUE, ROUNDING, Array


@dataclass(frozen=True)
class GroupComparison:
    """What two independent groups say of their means.

    Parameters
    ----------
    n_first, n_second : int
        Values.
    mean_first, mean_second : float
        Of each group, in the unit of the data.
    difference, low, high : float
        Mean of first minus mean of second, with its 95 % interval (Student's t, Welch-Satterthwaite degrees of
        freedom), in the unit of the data.
    degrees_of_freedom : float
        By Welch and Satterthwaite.
    effect_size : float
        Hedges' g: the difference over the pooled standard deviation, without its small-sample bias; positive where the
        first mean is larger.
    p_value : float
        Two-sided, by Welch's t-test.
    """

    n_first: int
    n_second: int
    mean_first: float
    mean_second: float
    difference: float
    low: float
    high: float
    degrees_of_freedom: float
    effect_size: float
    p_value: float

    def tabulate(self) -> dict[str, float]:
        """Return the columns of a table's row that sample sizes and means do not belong to."""
        return {
            "difference": self.difference,
            "low": self.low,
            "high": self.high,
            "hedges_g": self.effect_size,
            "p_welch": self.p_value,
        }


@dataclass(frozen=True)
class ScaledGroups:
    """Moments of two groups, divided by a power of two that brings their largest value near 1.

    Parameters
    ----------
    exponent : int
        Of the power of two.
    n, mean, sd : tuple of two
        Values, mean and standard deviation (n - 1) of each group.
    error : float
        Standard error of the difference of means; NaN with fewer than two values in a group, where neither has a spread
        or a value is missing.
    degrees_of_freedom : float
        By Welch and Satterthwaite; NaN where the error is.
    """

    exponent: int
    n: tuple[int, int]
    mean: tuple[float, float]
    sd: tuple[float, float]
    error: float
    degrees_of_freedom: float

    @property
    def difference(self) -> float:
        """Mean of first minus mean of second."""
        return self.mean[0] - self.mean[1]


def scale_groups(first: Array, second: Array) -> ScaledGroups:
    """Return the moments that tests of two groups take.

    Parameters
    ----------
    first, second : (n,) and (m,) float arrays
        Values of each group.

    Raises
    ------
    ValueError
        When a group is not a vector or is empty, or a value is absurdly large.
    """
    groups = [np.asarray(each, dtype=float) for each in (first, second)]
    if any(each.ndim != 1 or not each.size for each in groups):
        raise ValueError(f"expected two vectors that are not empty, got shapes {groups[0].shape} and {groups[1].shape}")
    largest = max(float(np.nan_to_num(np.fmax.reduce(np.abs(each)), posinf=np.inf)) for each in groups)
    if largest > LARGEST_VALUE:
        raise ValueError(f"expected values within {LARGEST_VALUE:g}, got {largest}")
    # squares of values near 1 neither overflow nor vanish; a power of two leaves every digit as it is
    exponent = int(np.frexp(largest)[1])
    groups = [np.ldexp(each, -exponent) for each in groups]
    n = groups[0].size, groups[1].size
    mean = float(groups[0].mean()), float(groups[1].mean())
    sd, error, degrees = (np.nan, np.nan), np.nan, np.nan
    if min(n) > 1:
        sd = float(groups[0].std(ddof=1)), float(groups[1].std(ddof=1))
        if max(np.ptp(groups[0]), np.ptp(groups[1])) > ROUNDING:
            parts = sd[0] ** 2 / n[0], sd[1] ** 2 / n[1]
            total = parts[0] + parts[1]
            error = float(np.sqrt(total))
            degrees = 1 / ((parts[0] / total) ** 2 / (n[0] - 1) + (parts[1] / total) ** 2 / (n[1] - 1))
    return ScaledGroups(exponent, n, mean, sd, error, degrees)


def compare_groups(first: Array, second: Array) -> GroupComparison:
    """Compare the means of two independent groups without assuming equal variances.

    Parameters
    ----------
    first, second : (n,) and (m,) float arrays
        Values of each group, in one unit.

    Returns
    -------
    GroupComparison
        Interval, degrees of freedom, effect size and p-value are NaN with fewer than two values in a group or where
        each group's values are equal to rounding; a missing value (NaN) makes all but n and the other group's mean NaN.

    Raises
    ------
    ValueError
        When a group is not a vector or is empty, or a value is absurdly large.

    Notes
    -----
    Welch, The generalization of 'Student's' problem when several different population variances are involved,
    Biometrika 34 (1947). Hedges, Distribution theory for Glass's estimator of effect size and related estimators,
    J. Educ. Stat. 6 (1981), with the exact factor.
    """
    from scipy import special, stats  # slow to import, and most runs compare nothing

    moments = scale_groups(first, second)
    low = high = effect = p_value = np.nan
    if np.isfinite(moments.error):
        half = float(stats.t.ppf(0.975, moments.degrees_of_freedom)) * moments.error
        low, high = moments.difference - half, moments.difference + half
        p_value = 2 * float(stats.t.sf(abs(moments.difference) / moments.error, moments.degrees_of_freedom))
        weights = moments.n[0] - 1, moments.n[1] - 1
        pooled = np.sqrt((weights[0] * moments.sd[0] ** 2 + weights[1] * moments.sd[1] ** 2) / sum(weights))
        degrees = sum(weights)
        unbiased = np.exp(special.gammaln(degrees / 2) - special.gammaln((degrees - 1) / 2)) / np.sqrt(degrees / 2)
        effect = float(unbiased * moments.difference / pooled)
    return GroupComparison(
        n_first=moments.n[0],
        n_second=moments.n[1],
        mean_first=float(np.ldexp(moments.mean[0], moments.exponent)),
        mean_second=float(np.ldexp(moments.mean[1], moments.exponent)),
        difference=float(np.ldexp(moments.difference, moments.exponent)),
        low=float(np.ldexp(low, moments.exponent)),
        high=float(np.ldexp(high, moments.exponent)),
        degrees_of_freedom=float(moments.degrees_of_freedom),
        effect_size=effect,
        p_value=p_value,
    )
