"""Paired comparisons against SciPy and hand-made numbers; adjusted p-values against their rules."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats

from stages.science.statistics.paired import adjust_holm, compare_pairs

COMMON = settings(derandomize=True, deadline=None, max_examples=40)
UNDEFINED = ("low", "high", "d_z", "p_t", "p_wilcoxon")


def pairs(values):
    """Draw two vectors of one length, as the rows of an array."""
    return st.integers(2, 7).flatmap(lambda n: arrays(float, (2, n), elements=values))


@COMMON
@given(pairs(st.one_of(st.floats(-10, 10), st.integers(-3, 3).map(float))))
def test_agrees_with_scipy_where_differences_differ(values):
    told = compare_pairs(*values)
    difference = values[0] - values[1]
    if np.ptp(difference) <= 1e-9:
        return
    assert (told.n, told.wins) == (difference.size, np.sum(difference < 0))
    np.testing.assert_allclose(told.difference, difference.mean(), rtol=1e-12, atol=1e-14)
    test = stats.ttest_1samp(difference, 0.0)
    interval = test.confidence_interval(0.95)
    # 1e-9 of the largest value: differences of range 1e-9 keep seven digits
    np.testing.assert_allclose([told.low, told.high], [interval.low, interval.high], rtol=1e-6, atol=1e-14)
    np.testing.assert_allclose(told.p_t, test.pvalue, rtol=1e-6, atol=1e-300)
    np.testing.assert_allclose(told.p_wilcoxon, stats.wilcoxon(difference).pvalue, rtol=1e-12)
    np.testing.assert_allclose(told.d_z, test.statistic / np.sqrt(told.n), rtol=1e-6, atol=1e-12)


@COMMON
@given(arrays(float, st.integers(1, 12), elements=st.floats(-10, 10)), st.floats(-10, 10), st.integers(-480, 480))
def test_differences_that_only_rounding_parts_are_equal(second, shift, exponent):
    told = compare_pairs(np.ldexp(second + shift, exponent), np.ldexp(second, exponent))
    assert np.isnan([getattr(told, name) for name in UNDEFINED]).all()
    assert told.difference == pytest.approx(np.ldexp(shift, exponent), abs=np.ldexp(1e-14, exponent))


@settings(COMMON, max_examples=15)
@given(pairs(st.integers(0, 255)))
def test_integers_of_any_kind_are_numbers(values):
    for dtype in (np.uint8, np.int16, np.int64):
        np.testing.assert_equal(vars(compare_pairs(*values.astype(dtype))), vars(compare_pairs(*values.astype(float))))


@settings(COMMON, max_examples=15)
@given(
    arrays(float, st.integers(0, 12), elements=st.one_of(st.floats(0, 1), st.sampled_from([0.0, 1.0, np.nan, 0.01])))
)
def test_holm_is_the_step_down_rule_and_keeps_nan(p_values):
    adjusted = adjust_holm(p_values)
    known = ~np.isnan(p_values)
    np.testing.assert_array_equal(np.isnan(adjusted), ~known)
    steps = np.maximum.accumulate(np.sort(p_values[known]) * np.arange(known.sum(), 0, -1))
    np.testing.assert_allclose(np.sort(adjusted[known]), np.minimum(1.0, steps), rtol=1e-12)
    assert (adjusted[known] >= p_values[known]).all()
    order = np.random.default_rng(0).permutation(p_values.size)
    np.testing.assert_array_equal(adjust_holm(p_values[order]), adjusted[order])
