"""Two methods on the same experiments: difference, interval, effect size, two tests.

One figure of merit per experiment and method flows in; one `PairedComparison` flows out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LARGEST_VALUE = 1e300
"""Intervals of values within it are finite."""

ROUNDING = 4 * float(np.finfo(float).eps)
"""Range of the differences, per largest value, that rounding of values and differences alone can cause."""


@dataclass(frozen=True)
class PairedComparison:
    """What paired experiments say of two methods.

    Parameters
    ----------
    n : int
        Pairs.
    mean_first, mean_second : float
        Of each method.
    difference, low, high : float
        Mean of first minus second, with its 95 % interval (Student's t).
    effect_size : float
        Mean difference over the standard deviation of the differences (Cohen's d_z).
    t_p_value : float
        Two-sided paired t-test.
    wilcoxon_p_value : float
        Two-sided Wilcoxon signed-rank test, exact for small n.
    wins : int
        Pairs in which the first is smaller.
    """

    n: int
    mean_first: float
    mean_second: float
    difference: float
    low: float
    high: float
    effect_size: float
    t_p_value: float
    wilcoxon_p_value: float
    wins: int

    def tabulate(self, first: str, second: str) -> dict[str, float]:
        """Return the columns of a table's row; those of the means begin with the methods' names."""
        return {
            "n": self.n,
            f"{first}_mean": self.mean_first,
            f"{second}_mean": self.mean_second,
            "difference": self.difference,
            "low": self.low,
            "high": self.high,
            "d_z": self.effect_size,
            "wins": self.wins,
            "p_t": self.t_p_value,
            "p_wilcoxon": self.wilcoxon_p_value,
        }


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

    first, second = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    if first.shape != second.shape or first.ndim != 1 or not first.size:
        raise ValueError(f"expected two vectors of one length, got shapes {first.shape} and {second.shape}")
    largest = float(np.nan_to_num(np.fmax.reduce(np.abs([first, second]), axis=None), posinf=np.inf))
    if largest > LARGEST_VALUE:
        raise ValueError(f"expected values within {LARGEST_VALUE:g}, got {largest}")
    signed = first - second
    # squares of values near 1 neither overflow nor vanish; a power of two leaves every digit as it is
    exponent = int(np.frexp(largest)[1])
    first, second = np.ldexp(first, -exponent), np.ldexp(second, -exponent)
    difference = first - second
    n = difference.size
    mean = float(difference.mean())
    spread = float(difference.std(ddof=1)) if n > 1 else np.nan
    low = high = effect = t_p = wilcoxon_p = np.nan
    if n > 1 and np.ptp(difference) > ROUNDING:
        half = float(stats.t.ppf(0.975, n - 1)) * spread / np.sqrt(n)
        low, high, effect = mean - half, mean + half, mean / spread
        t_p = float(stats.ttest_rel(first, second).pvalue)
        wilcoxon_p = float(stats.wilcoxon(signed).pvalue)
    return PairedComparison(
        n=n,
        mean_first=float(np.ldexp(first.mean(), exponent)),
        mean_second=float(np.ldexp(second.mean(), exponent)),
        difference=float(np.ldexp(mean, exponent)),
        low=float(np.ldexp(low, exponent)),
        high=float(np.ldexp(high, exponent)),
        effect_size=effect,
        t_p_value=t_p,
        wilcoxon_p_value=wilcoxon_p,
        wins=int((signed < 0).sum()),
    )


def adjust_holm(p_values: Array) -> Array:
    """Return p-values adjusted for their number by Holm's step-down rule; NaN stays NaN."""
    from statsmodels.stats.multitest import multipletests

    adjusted = np.full(p_values.shape, np.nan)
    known = ~np.isnan(p_values)
    if known.any():
        adjusted[known] = multipletests(p_values[known], method="holm")[1]
    return adjusted
