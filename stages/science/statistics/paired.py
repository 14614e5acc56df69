"""Two methods on the same experiments: difference, interval, effect size, two tests.

One figure of merit per experiment and method flows in; one `PairedComparison` flows out.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LARGEST_VALUE = 1e300
"""Intervals of values within it are finite."""

ROUNDING = 4 * float(np.finfo(float).eps)
"""Range of the differences, per largest value, that rounding of values and differences alone can cause."""


@dataclass(frozen=True)
class PairedComparison:
    """What paired experiments say of two methods, as columns of a table.

    Parameters
    ----------
    n : int
        Pairs.
    first_mean, second_mean : float
        Of each method.
    difference, low, high : float
        Mean of first minus second, with its 95 % interval (Student's t).
    d_z : float
        Mean difference over the standard deviation of the differences (Cohen).
    wins : int
        Pairs in which the first is smaller.
    p_t, p_wilcoxon : float
        Two-sided: paired t-test, and Wilcoxon signed-rank test, exact for small n.
    """

    n: int
    first_mean: float
    second_mean: float
    difference: float
    low: float
    high: float
    d_z: float
    wins: int
    p_t: float
    p_wilcoxon: float

    def tabulate(self, first: str, second: str) -> dict[str, Any]:
        """Return the columns of a table's row, those of the means also by the methods' names."""
        return {**vars(self), f"{first}_mean": self.first_mean, f"{second}_mean": self.second_mean}


def compare_pairs(first: Array, second: Array) -> PairedComparison:
    """Compare two methods on the same experiments.

    Parameters
    ----------
    first, second : (n,) float arrays
        A figure of merit of each method on each experiment.

    Returns
    -------
    PairedComparison
        Interval, effect size and p-values are NaN with fewer than two pairs or where all differences are equal to
        rounding; a missing value (NaN) makes all but wins and the other method's mean NaN.

    Raises
    ------
    ValueError
        When the arrays do not pair up or a value is absurdly large.
    """
    from scipy import stats  # slow to import, and most runs compare nothing

    first, second = read_pairs(first, second)
    exponent, signed = find_exponent(first, second), first - second
    first, second = np.ldexp(first, -exponent), np.ldexp(second, -exponent)
    difference = first - second
    n = difference.size
    mean = float(difference.mean())
    low = high = d_z = p_t = p_wilcoxon = np.nan
    if n > 1 and np.ptp(difference) > ROUNDING:
        spread = float(difference.std(ddof=1))
        half = float(stats.t.ppf(0.975, n - 1)) * spread / np.sqrt(n)
        low, high, d_z = mean - half, mean + half, mean / spread
        p_t = float(stats.ttest_rel(first, second).pvalue)
        p_wilcoxon = float(stats.wilcoxon(signed).pvalue)
    means = float(np.ldexp(first.mean(), exponent)), float(np.ldexp(second.mean(), exponent))
    mean, low, high = (float(np.ldexp(each, exponent)) for each in (mean, low, high))
    return PairedComparison(n, *means, mean, low, high, d_z, int((signed < 0).sum()), p_t, p_wilcoxon)


def read_pairs(first: Array, second: Array) -> tuple[Array, Array]:
    """Return both as vectors of numbers; refuse what does not pair up."""
    first, second = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    if first.shape != second.shape or first.ndim != 1 or not first.size:
        raise ValueError(f"expected two vectors of one length, got shapes {first.shape} and {second.shape}")
    return first, second


def find_exponent(first: Array, second: Array) -> int:
    """Return the exponent of the power of two that brings the largest value near 1; refuse absurdly large values.

    Squares of values near 1 neither overflow nor vanish, and a power of two leaves every digit as it is.
    """
    largest = max(float(np.nan_to_num(np.fmax.reduce(np.abs(each)), posinf=np.inf)) for each in (first, second))
    if largest > LARGEST_VALUE:
        raise ValueError(f"expected values within {LARGEST_VALUE:g}, got {largest}")
    return int(np.frexp(largest)[1])


def adjust_holm(p_values: Array) -> Array:
    """Return p-values adjusted for their number by Holm's step-down rule; NaN stays NaN."""
    from statsmodels.stats.multitest import multipletests

    adjusted = np.full(p_values.shape, np.nan)
    known = ~np.isnan(p_values)
    if known.any():
        adjusted[known] = multipletests(p_values[known], method="holm")[1]
    return adjusted
