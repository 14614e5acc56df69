"""Intervals of shares and medians: of few sessions, and of values in blocks that depend on each other."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stages.science.statistics.paired import Array


def bound_rate(hits: NDArray[np.bool_], level: float) -> tuple[float, float, float]:
    """Return a share with Wilson's interval (J. Am. Stat. Assoc. 22, 1927); nan without values."""
    from statsmodels.stats.proportion import proportion_confint

    if hits.size == 0:
        return math.nan, math.nan, math.nan
    low, high = proportion_confint(int(hits.sum()), hits.size, alpha=1.0 - level, method="wilson")
    return float(hits.mean()), float(low), float(high)


def bound_median(values: Array, level: float) -> tuple[float, float, float]:
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


def bound_mean(values: Array, level: float) -> tuple[float, float, float]:
    """Return a mean with its interval (Student's t); nan for the ends where there is one value."""
    from scipy.special import stdtrit

    mean, count = float(values.mean()), values.size
    half = float(stdtrit(count - 1, 0.5 + 0.5 * level) * values.std(ddof=1) / np.sqrt(count)) if count > 1 else math.nan
    return mean, mean - half, mean + half


@dataclass(frozen=True)
class Coverage:
    """Share of values within their intervals where those of a block depend on each other.

    Parameters
    ----------
    n, blocks : int
        Values and blocks.
    share : float
        Over all values, each counting the same.
    low, high : float
        95 % interval of the blocks' mean share (Student's t over blocks), cut at 0 and 1; NaN with fewer than two
        blocks or where all blocks have one share.
    """

    n: int
    blocks: int
    share: float
    low: float
    high: float


def cover_blocks(values: Array, low: Array, high: Array, blocks: ArrayLike) -> Coverage:
    """Count the values within their intervals, block by block; nothing is assumed of the values in a block.

    Parameters
    ----------
    values : (n,) float array
        What was measured.
    low, high : (n,) float arrays
        Ends of each value's interval, which belong to it, in the unit of the values; they may be infinite.
    blocks : (n,) array_like
        Label of the block (a trial, a person) that each value belongs to.
    """
    inside = (low <= values) & (values <= high)
    members = np.unique(np.asarray(blocks), return_inverse=True)[1]
    size = np.bincount(members)
    shares = np.bincount(members, weights=inside) / size
    bottom = top = np.nan
    if np.ptp(shares):
        _, bottom, top = bound_mean(shares, 0.95)
    return Coverage(inside.size, size.size, float(inside.mean()), max(bottom, 0.0), min(top, 1.0))
