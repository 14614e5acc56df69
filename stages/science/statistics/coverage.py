"""How often intervals hold what they should: shares with intervals, of independent samples and of blocks.

Values and their intervals flow in; a `Coverage` or a `BlockCoverage` flows out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stages.science.statistics.paired import Array


@dataclass(frozen=True)
class Coverage:
    """Share of values within their intervals; the unit is the value.

    Parameters
    ----------
    n, inside : int
        Values, and those within.
    share, low, high : float
        Inside over n, with Wilson's 95 % interval.
    """

    n: int
    inside: int
    share: float
    low: float
    high: float


@dataclass(frozen=True)
class BlockCoverage:
    """Share of values within their intervals where those of a block depend on each other; the unit is the block.

    Parameters
    ----------
    n, blocks : int
        Values and blocks.
    share : float
        Over all values, each counting the same.
    block_mean, low, high : float
        Mean of the blocks' shares, each block counting the same, with its 95 % interval (Student's t over blocks),
        cut at 0 and 1.
    block_sd : float
        Standard deviation of the blocks' shares.
    """

    n: int
    blocks: int
    share: float
    block_mean: float
    low: float
    high: float
    block_sd: float


def cover(values: Array, low: Array, high: Array) -> Coverage:
    """Count the values within their intervals, as if they were independent.

    Parameters
    ----------
    values : (n,) float array
        What was measured.
    low, high : (n,) float arrays
        Ends of each value's interval, which belong to it, in the unit of the values; they may be infinite.

    Returns
    -------
    Coverage
        Share and interval are NaN where a value or an end is missing (NaN).

    Raises
    ------
    ValueError
        When the arrays are not vectors of one length, are empty, a value is infinite or an interval is turned round.

    Notes
    -----
    Wilson, Probable inference, the law of succession, and statistical inference, J. Am. Stat. Assoc. 22 (1927). Its
    interval is too narrow where values depend on each other; see `cover_blocks`.
    """
    from scipy import special

    inside, known = _find_inside(values, low, high)
    n, count = inside.size, int(inside.sum())
    if not known:
        return Coverage(n, count, np.nan, np.nan, np.nan)
    z = float(special.ndtri(0.975))
    share = count / n
    centre = (count + z**2 / 2) / (n + z**2)
    half = z * np.sqrt(n) / (n + z**2) * np.sqrt(share * (1 - share) + z**2 / (4 * n))
    # zero and all are ends of their own interval, to the last digit
    return Coverage(
        n,
        count,
        share,
        float(max(centre - half, 0.0)) if count else 0.0,
        float(min(centre + half, 1.0)) if count < n else 1.0,
    )


def cover_blocks(values: Array, low: Array, high: Array, blocks: ArrayLike) -> BlockCoverage:
    """Count the values within their intervals, block by block.

    Parameters
    ----------
    values : (n,) float array
        What was measured.
    low, high : (n,) float arrays
        Ends of each value's interval, which belong to it, in the unit of the values; they may be infinite.
    blocks : (n,) array_like
        Label of the block (a trial, a person) that each value belongs to.

    Returns
    -------
    BlockCoverage
        The interval is NaN with fewer than two blocks or where all blocks have one share, the standard deviation with
        fewer than two blocks, and all but the counts where a value or an end is missing (NaN).

    Raises
    ------
    ValueError
        When the arrays are not vectors of one length, are empty, a value is infinite or an interval is turned round.

    Notes
    -----
    Blocks are taken for independent of each other; nothing is assumed of the values in a block.
    """
    from scipy import stats

    inside, known = _find_inside(values, low, high)
    labels = np.asarray(blocks)
    if labels.shape != inside.shape:
        raise ValueError(f"expected a block for each value, got shapes {labels.shape} and {inside.shape}")
    members = np.unique(labels, return_inverse=True)[1]
    size = np.bincount(members)
    count = size.size
    if not known:
        return BlockCoverage(inside.size, count, np.nan, np.nan, np.nan, np.nan, np.nan)
    shares = np.bincount(members, weights=inside) / size
    mean = float(shares.mean())
    sd = bottom = top = np.nan
    if count > 1:
        sd = float(shares.std(ddof=1)) if np.ptp(shares) else 0.0
        if sd:
            half = float(stats.t.ppf(0.975, count - 1)) * sd / np.sqrt(count)
            bottom, top = float(max(mean - half, 0.0)), float(min(mean + half, 1.0))
    return BlockCoverage(inside.size, count, float(inside.mean()), mean, bottom, top, sd)


def _find_inside(values: Array, low: Array, high: Array) -> tuple[NDArray[np.bool_], bool]:
    """Return which values are within, and whether all are known."""
    values, low, high = (np.asarray(each, dtype=float) for each in (values, low, high))
    if not values.shape == low.shape == high.shape or values.ndim != 1 or not values.size:
        raise ValueError(f"expected three vectors of one length, got shapes {values.shape}, {low.shape}, {high.shape}")
    if np.isinf(values).any():
        raise ValueError("expected finite values, got an infinite one")
    if (low > high).any():
        worst = int(np.argmax(low > high))
        raise ValueError(f"expected intervals from low to high, got {low[worst]} to {high[worst]}")
    known = not bool(np.isnan([values, low, high]).any())
    return (low <= values) & (values <= high), known
