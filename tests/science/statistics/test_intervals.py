"""Shares of values within their intervals against SciPy, and by symmetry."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats

from stages.science.statistics.intervals import cover_blocks

COMMON = settings(derandomize=True, deadline=None, max_examples=60)


def intervals(values):
    """Draw values, lower and upper ends."""
    return st.integers(1, 20).flatmap(lambda n: arrays(float, (3, n), elements=values)).map(turn)


def turn(drawn):
    return np.stack([drawn[0], drawn[1:].min(axis=0), drawn[1:].max(axis=0)])


def test_ends_belong_to_the_interval_and_may_be_infinite():
    ends = np.array([1.0, -np.inf, -np.inf, 4.0]), np.array([2.0, 2.0, np.inf, 4.5])
    assert cover_blocks(np.array([1.0, 2.0, 3.0, 4.6]), *ends, [1, 1, 1, 1]).share == 0.75


def test_blocks_by_hand():
    values = np.array([0.0, 0.0, 9.0, 0.0, 9.0, 9.0, 0.0])
    told = cover_blocks(values, values * 0 - 1, values * 0 + 1, ["b", "b", "b", "a", "c", "c", "c"])
    shares = np.array([2 / 3, 1.0, 1 / 3])
    assert (told.n, told.blocks, told.share) == (7, 3, pytest.approx(4 / 7))
    interval = stats.ttest_1samp(shares, 0.0).confidence_interval(0.95)
    assert told.low == pytest.approx(max(interval.low, 0))
    assert told.high == pytest.approx(min(interval.high, 1))


@COMMON
@given(intervals(st.one_of(st.floats(-1e300, 1e300), st.integers(-2, 2).map(float))), st.data())
def test_shares_and_their_intervals_lie_within_0_and_1(drawn, data):
    labels = data.draw(arrays(int, drawn.shape[1], elements=st.integers(0, 3)))
    blocks = cover_blocks(*drawn, labels)
    assert 0 <= blocks.share <= 1
    assert blocks.blocks == np.unique(labels).size
    if not np.isnan(blocks.low):
        assert 0 <= blocks.low < blocks.high <= 1
    # neither scale, sign, order nor names of blocks matter
    order = np.random.default_rng(0).permutation(labels.size)
    mirrored = -drawn[0, order], -drawn[2, order], -drawn[1, order]
    np.testing.assert_allclose(
        list(vars(cover_blocks(*mirrored, 7 - labels[order])).values()), list(vars(blocks).values()), rtol=1e-9
    )


@pytest.mark.parametrize("labels", [[1, 1, 1, 1], [1, 1, 2, 2]])
def test_without_a_spread_of_blocks_there_is_no_interval(labels):
    values = np.array([0.0, 9.0, 0.0, 9.0])
    told = cover_blocks(values, values * 0 - 1, values * 0 + 1, labels)
    assert told.share == 0.5
    assert np.isnan([told.low, told.high]).all()
