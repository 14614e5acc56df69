"""Two independent groups: difference, interval, effect size and Welch's test.

One value per member of each group flows in; one `GroupComparison` flows out.
"""

from dataclasses import dataclass

import numpy as np

from stages.science.statistics.paired import ROUNDING, Array, find_exponent


@dataclass(frozen=True)
class GroupComparison:
    """What two independent groups say of their means, as columns of a table.

    Parameters
    ----------
    n_first, n_second : int
        Values.
    first_mean, second_mean : float
        Of each group, in the unit of the data.
    difference, low, high : float
        Mean of first minus mean of second, with its 95 % interval (Student's t, Welch-Satterthwaite degrees of
        freedom), in the unit of the data.
    hedges_g : float
        The difference over the pooled standard deviation, without its small-sample bias.
    p_welch : float
        Two-sided, by Welch's t-test.
    """

    n_first: int
    n_second: int
    first_mean: float
    second_mean: float
    difference: float
    low: float
    high: float
    hedges_g: float
    p_welch: float


@dataclass(frozen=True)
class ScaledGroups:
    """Moments of two groups, divided by a power of two that brings their largest value near 1.

    Parameters
    ----------
    exponent : int
        Of the power of two.
    n, mean, sd : tuple of two
        Values, mean and standard deviation (n - 1) of each group.
    error, degrees_of_freedom : float
        Standard error of the difference of means, by Welch and Satterthwaite; NaN with fewer than two values in a
        group, where neither has a spread or a value is missing.
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
    exponent = find_exponent(*groups)
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
        Interval, effect size and p-value are NaN with fewer than two values in a group or where each group's values
        are equal to rounding; a missing value (NaN) makes all but n and the other group's mean NaN.

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
    low = high = hedges_g = p_welch = np.nan
    if np.isfinite(moments.error):
        half = float(stats.t.ppf(0.975, moments.degrees_of_freedom)) * moments.error
        low, high = moments.difference - half, moments.difference + half
        p_welch = 2 * float(stats.t.sf(abs(moments.difference) / moments.error, moments.degrees_of_freedom))
        weights = moments.n[0] - 1, moments.n[1] - 1
        pooled = np.sqrt((weights[0] * moments.sd[0] ** 2 + weights[1] * moments.sd[1] ** 2) / sum(weights))
        degrees = sum(weights)
        unbiased = np.exp(special.gammaln(degrees / 2) - special.gammaln((degrees - 1) / 2)) / np.sqrt(degrees / 2)
        hedges_g = float(unbiased * moments.difference / pooled)
    first_mean, second_mean, difference, low, high = (
        float(np.ldexp(each, moments.exponent)) for each in (*moments.mean, moments.difference, low, high)
    )
    return GroupComparison(*moments.n, first_mean, second_mean, difference, low, high, hedges_g, p_welch)
