"""Any paired values: comparisons against SciPy, by symmetry and by scale; Holm's rule against its definition."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats
from statsmodels.stats.multitest import multipletests

from stages.statistics import adjust_holm, compare_pairs

COMMON = settings(derandomize=True, deadline=None, max_examples=100)
ANY = st.floats(-1e300, 1e300)
UNDEFINED = ("low", "high", "effect_size", "t_p_value", "wilcoxon_p_value")
EXPONENTS = st.integers(-480, 480)


def pairs(values, least=1):
    """Draw two vectors of one length, as the rows of an array."""
    return st.integers(least, 8).flatmap(lambda n: arrays(float, (2, n), elements=values))


def numbers(told):
    return {name: value for name, value in vars(told).items() if name not in ("n", "wins")}


@COMMON
@given(pairs(st.one_of(ANY, st.floats(-10, 10), st.integers(-3, 3).map(float))))
@example(np.array([[1e300, -1e300], [-1e300, 1e300]]))
@example(np.array([[5e-324, 1e-323], [0.0, 0.0]]))
def test_every_number_is_finite_or_all_that_need_a_spread_are_missing(values):
    told = numbers(compare_pairs(*values))
    missing = {name for name, value in told.items() if np.isnan(value)}
    assert missing in (set(), set(UNDEFINED))
    assert all(np.isfinite(value) for name, value in told.items() if name not in missing)
    if not missing:
        assert told["low"] <= told["difference"] <= told["high"]
        assert 0 <= told["t_p_value"] <= 1
        assert 0 < told["wilcoxon_p_value"] <= 1


@COMMON
@given(pairs(st.one_of(ANY, st.integers(-3, 3).map(float))))
def test_swapping_the_methods_turns_every_sign(values):
    told, turned = compare_pairs(*values), compare_pairs(*values[::-1])
    assert (told.mean_first, told.mean_second) == (turned.mean_second, turned.mean_first)
    assert told.difference == -turned.difference
    np.testing.assert_array_equal(
        [told.low, told.high, told.effect_size], [-turned.high, -turned.low, -turned.effect_size]
    )
    np.testing.assert_array_equal([told.t_p_value, told.wilcoxon_p_value], [turned.t_p_value, turned.wilcoxon_p_value])
    assert told.wins + turned.wins == np.sum(values[0] != values[1])


@COMMON
@given(pairs(st.integers(-1000, 1000).map(float), least=2), EXPONENTS)
def test_a_power_of_two_scales_all_that_has_a_unit_and_nothing_else(values, exponent):
    told, scaled = numbers(compare_pairs(*values)), numbers(compare_pairs(*np.ldexp(values, exponent)))
    for name, value in told.items():
        unit = exponent if name in ("mean_first", "mean_second", "difference", "low", "high") else 0
        np.testing.assert_array_equal(np.ldexp(value, unit), scaled[name], err_msg=name)


@COMMON
@given(pairs(st.one_of(st.floats(-10, 10), st.integers(-3, 3).map(float)), least=2))
def test_agrees_with_scipy_where_differences_differ(values):
    told = compare_pairs(*values)
    difference = values[0] - values[1]
    if np.ptp(difference) <= 1e-9:
        return
    test = stats.ttest_1samp(difference, 0.0)
    interval = test.confidence_interval(0.95)
    # 1e-9 of the largest value: differences of range 1e-9 keep seven digits
    np.testing.assert_allclose([told.low, told.high], [interval.low, interval.high], rtol=1e-6, atol=1e-14)
    np.testing.assert_allclose(told.t_p_value, test.pvalue, rtol=1e-6, atol=1e-300)
    np.testing.assert_allclose(told.wilcoxon_p_value, stats.wilcoxon(difference).pvalue, rtol=1e-12)
    np.testing.assert_allclose(told.effect_size, test.statistic / np.sqrt(told.n), rtol=1e-6, atol=1e-12)


@COMMON
@given(arrays(float, st.integers(1, 12), elements=st.floats(-10, 10)), st.floats(-10, 10), EXPONENTS)
def test_differences_that_only_rounding_parts_are_equal(second, shift, exponent):
    told = compare_pairs(np.ldexp(second + shift, exponent), np.ldexp(second, exponent))
    assert np.isnan([getattr(told, name) for name in UNDEFINED]).all()
    assert told.difference == pytest.approx(np.ldexp(shift, exponent), abs=np.ldexp(1e-14, exponent))


@COMMON
@given(pairs(st.integers(0, 255), least=2))
def test_integers_of_any_kind_are_numbers(values):
    for dtype in (np.uint8, np.int16, np.int64):
        np.testing.assert_equal(vars(compare_pairs(*values.astype(dtype))), vars(compare_pairs(*values.astype(float))))


@COMMON
@given(pairs(st.sampled_from([0.0, 1.0, 2.5, 1e300, -1e-300])), st.data())
def test_a_missing_value_is_missing_in_the_result(values, data):
    values[0, data.draw(st.integers(0, values.shape[1] - 1))] = np.nan
    told = numbers(compare_pairs(*values))
    assert told.pop("mean_second") == pytest.approx(values[1].mean())
    assert np.isnan(list(told.values())).all()


@pytest.mark.parametrize("value", [np.inf, -np.inf, 1.7e308])
@pytest.mark.parametrize("other", [0.0, np.nan, np.inf])
def test_an_absurd_value_is_refused(value, other):
    with pytest.raises(ValueError, match=r"expected values within 1e\+300, got "):
        compare_pairs(np.array([value, 0.0]), np.array([other, 1.0]))


@settings(COMMON, max_examples=6)  # statsmodels collects garbage at every call
@given(
    arrays(float, st.integers(0, 12), elements=st.one_of(st.floats(0, 1), st.sampled_from([0.0, 1.0, np.nan, 0.01])))
)
def test_holm_is_the_step_down_rule(p_values):
    adjusted = adjust_holm(p_values)
    known = ~np.isnan(p_values)
    np.testing.assert_array_equal(np.isnan(adjusted), ~known)
    count = int(known.sum())
    if not count:
        return
    np.testing.assert_allclose(adjusted[known], multipletests(p_values[known], method="holm")[1], rtol=1e-12)
    ordered = np.sort(p_values[known])
    steps = np.minimum(1.0, np.maximum.accumulate(ordered * np.arange(count, 0, -1)))
    np.testing.assert_allclose(np.sort(adjusted[known]), steps, rtol=1e-12)
    assert (adjusted[known] >= p_values[known]).all()
    order = np.random.default_rng(0).permutation(p_values.size)
    np.testing.assert_array_equal(adjust_holm(p_values[order]), adjusted[order])
