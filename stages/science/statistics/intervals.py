"""Intervals of shares and medians of few sessions; values flow in, estimates with both ends flow out."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def bound_rate(hits: NDArray[np.bool_], level: float) -> tuple[float, float, float]:
    """Return a share with Wilson's interval (J. Am. Stat. Assoc. 22, 1927); nan without values."""
    from statsmodels.stats.proportion import proportion_confint

    if hits.size == 0:
        return math.nan, math.nan, math.nan
    low, high = proportion_confint(int(hits.sum()), hits.size, alpha=1.0 - level, method="wilson")
    return float(hits.mean()), float(low), float(high)


def bound_median(values: NDArray[np.float64], level: float) -> tuple[float, float, float]:
    """Return a median with the interval between two order statistics; the extremes where there are too few for more.

    The number of values below the median is binomial, whatever their distribution (Conover, Practical Nonparametric
    Statistics, 1999, section 3.2).
    """
    from scipy.stats import binom

    if values.size == 0:
        return math.nan, math.nan, math.nan
    ordered = np.sort(values)
    below = int(binom.ppf(0.5 * (1.0 - level), values.size, 0.5))
    place = max(below - 1, 0)
    return float(np.median(ordered)), float(ordered[place]), float(ordered[values.size - 1 - place])
