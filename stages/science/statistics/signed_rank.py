"""Two methods on the same experiments, by ranks: Wilcoxon's test, its effect size and a typical difference.

One figure of merit per experiment and method flows in; one `RankComparison` flows out.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from stages.science.statistics.paired import LARGEST_VALUE, ROUNDING, Array

MOST_PAIRS = 4000
"""Pairs whose averages fit in memory."""

MOST_EXACT = 200
"""Pairs up to which the distribution of the rank sum is counted; beyond, it is taken for normal."""


@dataclass(frozen=True)
class RankComparison:
    """What the signed ranks of paired differences say.

    Parameters
    ----------
    n : int
        Pairs.
    estimate, low, high : float
        Hodges-Lehmann estimate of first minus second (the median of the averages of any two differences), with its
        interval of at least 95 %, in the unit of the data.
    confidence : float
        Of that interval, if differences are continuous and symmetric.
    effect_size : float
        Matched-pairs rank-biserial correlation: rank sum of the positive differences minus that of the negative ones,
        over both; from -1 (the first is always smaller) to 1.
    p_value : float
        Two-sided Wilcoxon signed-rank test, exact for small n.
    """

    n: int
    estimate: float
    low: float
    high: float
    confidence: float
    effect_size: float
    p_value: float


def compare_ranks(first: Array, second: Array) -> RankComparison:
    """Compare two methods on the same experiments by the signed ranks of their differences.

    Parameters
    ----------
    first, second : (n,) float arrays
        A figure of merit of each method on each experiment.

    Returns
    -------
    RankComparison
        Interval, confidence, effect size and p-value are NaN with fewer than two pairs or where all differences are
        equal to rounding; the interval and its confidence also with fewer than six pairs, whose signed ranks bound
        nothing at 95 %. A missing value (NaN) makes all but n NaN.

    Raises
    ------
    ValueError
        When the arrays do not pair up, a value is absurdly large or pairs are too many.

    Notes
    -----
    Hodges and Lehmann, Estimates of location based on rank tests, Ann. Math. Stat. 34 (1963); Kerby, The simple
    difference formula, Compr. Psychol. 3 (2014); interval as in Hollander, Wolfe and Chicken, Nonparametric Statistical
    Methods (2014), section 3.3. Test and effect size leave out differences of zero; estimate and interval do not.
    """
    from scipy import stats  # slow to import, and most runs compare nothing

    first, second = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    if first.shape != second.shape or first.ndim != 1 or not first.size:
        raise ValueError(f"expected two vectors of one length, got shapes {first.shape} and {second.shape}")
    if first.size > MOST_PAIRS:
        raise ValueError(f"expected at most {MOST_PAIRS} pairs, got {first.size}")
    largest = float(np.nan_to_num(np.fmax.reduce(np.abs([first, second]), axis=None), posinf=np.inf))
    if largest > LARGEST_VALUE:
        raise ValueError(f"expected values within {LARGEST_VALUE:g}, got {largest}")
    difference = first - second
    n = difference.size
    if np.isnan(difference).any():
        return RankComparison(n, *[np.nan] * 6)
    averages = np.sort((difference[:, None] + difference)[np.triu_indices(n)] / 2)
    low = high = confidence = effect = p_value = np.nan
    if n > 1 and np.ptp(np.ldexp(difference, -int(np.frexp(largest)[1]))) > ROUNDING:
        signed = difference[difference != 0]
        ranks = stats.rankdata(np.abs(signed))
        effect = float((np.sign(signed) * ranks).sum() / ranks.sum())
        p_value = float(stats.wilcoxon(difference).pvalue)
        left_out, tail = _trim(n)
        if left_out >= 0:
            low, high, confidence = float(averages[left_out]), float(averages[-1 - left_out]), 1 - 2 * tail
    return RankComparison(n, float(np.median(averages)), low, high, confidence, effect, p_value)


@cache
def _trim(n: int) -> tuple[int, float]:
    """Return the largest rank sum reached or undercut with at most 2.5 %, -1 if none, and that probability."""
    from scipy import special

    if n > MOST_EXACT:
        mean, sd = n * (n + 1) / 4, np.sqrt(n * (n + 1) * (2 * n + 1) / 24)
        found = int(np.floor(mean - float(special.ndtri(0.975)) * sd - 0.5))
        return found, float(special.ndtr((found + 0.5 - mean) / sd))
    probability = np.zeros(n * (n + 1) // 2 + 1)
    probability[0] = 1.0
    for rank in range(1, n + 1):
        probability[rank:] = (probability[rank:] + probability[:-rank]) / 2
        probability[:rank] /= 2
    cumulated = np.cumsum(probability)
    found = int(np.searchsorted(cumulated, 0.025, side="right")) - 1
    return found, float(cumulated[found]) if found >= 0 else np.nan
