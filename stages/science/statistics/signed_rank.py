"""Two methods on the same experiments, by ranks: Wilcoxon's test, its effect size and a typical difference.

One figure of merit per experiment and method flows in; one `RankComparison` flows out.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from stages.science.statistics.paired import ROUNDING, Array, find_exponent, read_pairs

MOST_EXACT = 200
"""Pairs up to which the distribution of the rank sum is counted; beyond, it is taken for normal."""


@dataclass(frozen=True)
class RankComparison:
    """What the signed ranks of paired differences say, as columns of a table.

    Parameters
    ----------
    n : int
        Pairs.
    hodges_lehmann, low, high : float
        Median of the averages of any two differences (first minus second), with its interval of at least 95 %.
    confidence : float
        Of that interval, if differences are continuous and symmetric.
    rank_biserial : float
        Effect size of matched pairs: rank sum of the positive differences minus that of the negative ones, over both;
        from -1 (the first is always smaller) to 1.
    p_wilcoxon : float
        Two-sided Wilcoxon signed-rank test, exact for small n.
    """

    n: int
    hodges_lehmann: float
    low: float
    high: float
    confidence: float
    rank_biserial: float
    p_wilcoxon: float


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
        When the arrays do not pair up or a value is absurdly large.

    Notes
    -----
    Hodges and Lehmann, Estimates of location based on rank tests, Ann. Math. Stat. 34 (1963); Kerby, The simple
    difference formula, Compr. Psychol. 3 (2014); interval as in Hollander, Wolfe and Chicken, Nonparametric Statistical
    Methods (2014), section 3.3. Test and effect size leave out differences of zero; estimate and interval do not.
    """
    from scipy import stats  # slow to import, and most runs compare nothing

    first, second = read_pairs(first, second)
    exponent = find_exponent(first, second)
    difference = first - second
    n = difference.size
    if np.isnan(difference).any():
        return RankComparison(n, *[np.nan] * 6)
    averages = np.sort((difference[:, None] + difference)[np.triu_indices(n)] / 2)
    low = high = confidence = effect = p_value = np.nan
    if n > 1 and np.ptp(np.ldexp(difference, -exponent)) > ROUNDING:
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
