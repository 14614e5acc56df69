"""Signed ranks against SciPy, and by enumeration."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats

from stages.science.statistics.signed_rank import MOST_EXACT, _trim, compare_ranks

COMMON = settings(derandomize=True, deadline=None, max_examples=40)


def test_hand_made_numbers():
    told = compare_ranks(np.array([1.0, -2.0, 3.0, 4.0, 5.0, 6.0]), np.zeros(6))
    assert told.rank_biserial == pytest.approx((19 - 2) / 21)
    assert told.hodges_lehmann == 3.0
    # 6 pairs: all averages, which hold the median unless all signs agree
    assert (told.low, told.high, told.confidence) == (-2.0, 6.0, pytest.approx(1 - 2 / 64))
    assert told.p_wilcoxon == pytest.approx(6 / 64)


@pytest.mark.parametrize("n", [6, 9, 12, 40])
def test_the_interval_is_the_test_inverted(generator, n):
    """A typical difference is within where SciPy's exact test does not reject it, at the level that n allows."""
    first = generator.normal(0.4, 1.0, n)
    told = compare_ranks(first, np.zeros(n))
    span = told.high - told.low
    for place in (told.low, told.high):
        inside, outside = (place + step * span * 1e-9 for step in ((1, -1) if place == told.low else (-1, 1)))
        assert stats.wilcoxon(first - inside).pvalue > 0.05
        assert stats.wilcoxon(first - outside).pvalue <= 0.05


def test_counted_and_normal_rank_sums_meet(monkeypatch):
    exact = _trim.__wrapped__(MOST_EXACT)
    monkeypatch.setattr("stages.science.statistics.signed_rank.MOST_EXACT", 10)
    near = _trim.__wrapped__(MOST_EXACT)
    assert abs(exact[0] - near[0]) <= 1
    assert exact[1] == pytest.approx(near[1], abs=2e-5)  # one rank sum more has 7e-5


def test_five_pairs_bound_nothing():
    told = compare_ranks(np.arange(5.0), np.zeros(5))
    assert np.isnan([told.low, told.high, told.confidence]).all()
    assert told.rank_biserial == 1.0
    assert told.p_wilcoxon == pytest.approx(0.125)


@COMMON
@given(st.integers(2, 7).flatmap(lambda n: arrays(float, (2, n), elements=st.integers(-5, 5).map(float))))
def test_the_effect_size_counts_ranks(values):
    told = compare_ranks(*values)
    signed = values[0] - values[1]
    if np.isnan(told.rank_biserial):
        return
    ranks = stats.rankdata(np.abs(signed[signed != 0]))
    positive, negative = (ranks[np.sign(signed[signed != 0]) == sign].sum() for sign in (1, -1))
    assert told.rank_biserial == pytest.approx((positive - negative) / (positive + negative))
