"""Coverage against statsmodels, Monte Carlo with and without dependence, and by symmetry."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats
from statsmodels.stats.proportion import proportion_confint

from stages.science.statistics.coverage import cover, cover_blocks

COMMON = settings(derandomize=True, deadline=None, max_examples=60)


def intervals(values):
    """Draw values, lower and upper ends."""
    return st.integers(1, 20).flatmap(lambda n: arrays(float, (3, n), elements=values)).map(turn)


def turn(drawn):
    return np.stack([drawn[0], drawn[1:].min(axis=0), drawn[1:].max(axis=0)])


@pytest.mark.parametrize(("inside", "n"), [(0, 5), (5, 5), (1, 1), (3, 7), (950, 1000)])
def test_wilsons_interval_is_that_of_statsmodels(inside, n):
    values = np.where(np.arange(n) < inside, 0.0, 9.0)
    told = cover(values, np.full(n, -1.0), np.ones(n))
    assert (told.n, told.inside, told.share) == (n, inside, inside / n)
    low, high = proportion_confint(inside, n, method="wilson")
    assert (told.low, told.high) == (pytest.approx(low, abs=1e-12), pytest.approx(high, abs=1e-12))


def test_ends_belong_to_the_interval_and_may_be_infinite():
    told = cover(np.array([1.0, 2.0, 3.0]), np.array([1.0, -np.inf, -np.inf]), np.array([2.0, 2.0, np.inf]))
    assert told.share == 1.0


def test_blocks_by_hand():
    values = np.array([0.0, 0.0, 9.0, 0.0, 9.0, 9.0, 0.0])
    told = cover_blocks(values, values * 0 - 1, values * 0 + 1, ["b", "b", "b", "a", "c", "c", "c"])
    shares = np.array([2 / 3, 1.0, 1 / 3])
    assert (told.n, told.blocks, told.share) == (7, 3, pytest.approx(4 / 7))
    assert told.block_mean == pytest.approx(shares.mean())
    assert told.block_sd == pytest.approx(shares.std(ddof=1))
    interval = stats.ttest_1samp(shares, 0.0).confidence_interval(0.95)
    assert told.low == pytest.approx(max(interval.low, 0))
    assert told.high == pytest.approx(min(interval.high, 1))


def simulate(generator, blocks, size, common):
    """Return errors whose sum of a block's part and a value's part has variance 1, of the stated common share."""
    ours = np.sqrt(common) * generator.standard_normal((blocks, 1))
    return (ours + np.sqrt(1 - common) * generator.standard_normal((blocks, size))).ravel()


@pytest.mark.parametrize("common", [0.0, 0.6])
def test_blocks_hold_the_true_share_where_values_depend_on_each_other(generator, common):
    """Errors of standard deviation 1 and intervals of 80 %: Wilson's fails with dependence, that of blocks does not."""
    blocks, size, half = 20, 30, float(stats.norm.ppf(0.9))
    labels, ends = np.repeat(np.arange(blocks), size), np.full(blocks * size, half)
    by_value, by_block = [], []
    for _ in range(600):
        errors = simulate(generator, blocks, size, common)
        told = cover(errors, -ends, ends)
        by_value.append(told.low <= 0.8 <= told.high)
        told = cover_blocks(errors, -ends, ends, labels)
        by_block.append(told.low <= 0.8 <= told.high)
    assert 0.89 < np.mean(by_block) < 0.98
    if common:
        assert np.mean(by_value) < 0.75
    else:
        assert 0.92 < np.mean(by_value) < 0.98


@COMMON
@given(intervals(st.one_of(st.floats(-1e300, 1e300), st.integers(-2, 2).map(float))), st.data())
def test_shares_and_their_intervals_lie_within_0_and_1(drawn, data):
    labels = data.draw(arrays(int, drawn.shape[1], elements=st.integers(0, 3)))
    told, blocks = cover(*drawn), cover_blocks(*drawn, labels)
    assert 0 <= told.low <= told.share <= told.high <= 1
    assert told.low < told.high
    assert blocks.share == pytest.approx(told.share)
    assert 0 <= blocks.block_mean <= 1
    assert np.isnan(blocks.block_sd) == (blocks.blocks < 2)
    assert np.isnan(blocks.low) == (blocks.blocks < 2 or blocks.block_sd == 0)
    if not np.isnan(blocks.low):
        assert 0 <= blocks.low <= blocks.block_mean <= blocks.high <= 1
    # neither scale, sign, order nor names of blocks matter
    order = np.random.default_rng(0).permutation(labels.size)
    mirrored = -drawn[0, order], -drawn[2, order], -drawn[1, order]
    assert cover(*mirrored) == told
    np.testing.assert_allclose(
        list(vars(cover_blocks(*mirrored, 7 - labels[order])).values()), list(vars(blocks).values()), rtol=1e-9
    )


def test_blocks_of_one_value_each_are_values():
    values = np.array([0.0, 9.0, 0.0, 0.0])
    told = cover_blocks(values, values * 0 - 1, values * 0 + 1, np.arange(4))
    assert told.share == told.block_mean == 0.75


def test_a_missing_value_is_missing_in_the_result():
    values = np.array([0.0, np.nan, 0.0])
    told = cover(values, np.full(3, -1.0), np.ones(3))
    assert np.isnan([told.share, told.low, told.high]).all()
    told = cover_blocks(values, np.full(3, -1.0), np.ones(3), np.arange(3))
    assert np.isnan([told.share, told.block_mean, told.low, told.high, told.block_sd]).all()
    assert (told.n, told.blocks) == (3, 3)


@pytest.mark.parametrize(
    ("values", "low", "high", "message"),
    [
        (
            np.zeros(2),
            np.zeros(3),
            np.ones(2),
            r"^expected three vectors of one length, got shapes \(2,\), \(3,\), .*$",
        ),
        (np.zeros(0), np.zeros(0), np.zeros(0), "^expected three vectors of one length, got .*$"),
        (np.array([np.inf]), np.zeros(1), np.ones(1), "^expected finite values, got an infinite one$"),
        (np.zeros(2), np.array([0.0, 2.0]), np.ones(2), "^expected intervals from low to high, got 2.0 to 1.0$"),
    ],
)
def test_absurd_intervals_are_refused(values, low, high, message):
    with pytest.raises(ValueError, match=message):
        cover(values, low, high)


def test_each_value_has_a_block():
    with pytest.raises(ValueError, match=r"^expected a block for each value, got shapes \(2,\) and \(3,\)$"):
        cover_blocks(np.zeros(3), np.zeros(3), np.zeros(3), [1, 2])
