"""Welch's comparison against SciPy and statsmodels, by symmetry, shift and scale."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats
from statsmodels.stats.weightstats import CompareMeans, DescrStatsW

from stages.statistics import compare_groups

COMMON = settings(derandomize=True, deadline=None, max_examples=60)
ANY = st.floats(-1e300, 1e300)
SMALL_INTEGERS = st.integers(-3, 3).map(float)
UNDEFINED = {"low", "high", "degrees_of_freedom", "effect_size", "p_value"}
WITH_A_UNIT = ("mean_first", "mean_second", "difference", "low", "high")


def groups(values, least=1):
    """Draw two vectors."""
    one = arrays(float, st.integers(least, 8), elements=values)
    return st.tuples(one, one)


def numbers(told):
    return {name: value for name, value in vars(told).items() if not name.startswith("n_")}


def test_agrees_with_scipy_and_statsmodels(generator):
    first, second = generator.normal(1.0, 0.3, 9), generator.normal(1.4, 0.9, 5)
    told = compare_groups(first, second)
    test = stats.ttest_ind(first, second, equal_var=False)
    low, high = CompareMeans(DescrStatsW(first), DescrStatsW(second)).tconfint_diff(0.05, usevar="unequal")
    assert (told.n_first, told.n_second) == (9, 5)
    assert told.difference == pytest.approx(first.mean() - second.mean())
    assert (told.low, told.high) == (pytest.approx(low), pytest.approx(high))
    assert told.degrees_of_freedom == pytest.approx(test.df)
    assert told.p_value == pytest.approx(test.pvalue)


def test_hedges_g_has_no_bias_and_a_sign(generator):
    found = [
        compare_groups(generator.normal(0.8, 2.0, 4), generator.normal(0.0, 2.0, 5)).effect_size for _ in range(4000)
    ]
    assert np.mean(found) == pytest.approx(0.4, abs=4 * np.std(found) / np.sqrt(4000))
    # of d = 1 with 2 + 2 values: the factor is gamma(1) / gamma(0.5)
    told = compare_groups(np.array([1.0, 3.0]), np.array([1.0, 3.0]) - np.sqrt(2))
    assert told.effect_size == pytest.approx(1 / np.sqrt(np.pi))


@pytest.mark.parametrize(("first", "second"), [([1.0], [1.0, 2.0]), ([1.0, 1.0], [2.0, 2.0, 2.0]), ([1.0], [3.0])])
def test_no_p_value_where_there_is_none(first, second):
    told = compare_groups(np.array(first), np.array(second))
    assert {name for name, value in numbers(told).items() if np.isnan(value)} == UNDEFINED
    assert told.difference == np.mean(first) - np.mean(second)


def test_one_group_without_spread_leaves_the_test_of_the_other():
    values = np.array([1.0, 2.0, 4.0])
    told, test = compare_groups(values, np.zeros(5)), stats.ttest_1samp(values, 0.0)
    assert told.p_value == pytest.approx(test.pvalue)
    assert told.degrees_of_freedom == pytest.approx(2)


@pytest.mark.parametrize("shapes", [(0, 2), (2, 0), ((2, 2), 2)])
def test_refuses_what_is_no_group(shapes):
    with pytest.raises(ValueError, match=r"^expected two vectors that are not empty, got shapes .*$"):
        compare_groups(np.zeros(shapes[0]), np.zeros(shapes[1]))


@pytest.mark.parametrize("value", [np.inf, -np.inf, 1.7e308])
def test_an_absurd_value_is_refused(value):
    with pytest.raises(ValueError, match=r"^expected values within 1e\+300, got .*$"):
        compare_groups(np.array([value, np.nan]), np.array([np.nan]))


def test_rates_of_false_and_of_true_findings(generator):
    """Unequal spreads and numbers, where Student's test finds far too much."""
    first, second = generator.normal(0, 3.0, (4000, 4)), generator.normal(0, 1.0, (4000, 12))
    told = [compare_groups(*each) for each in zip(first[:1500], second[:1500], strict=True)]
    found = stats.ttest_ind(first[:1500], second[:1500], axis=1, equal_var=False).pvalue
    np.testing.assert_allclose([each.p_value for each in told], found, rtol=1e-9)
    assert 0.03 < np.mean(found < 0.05) < 0.07
    assert 0.93 < np.mean([each.low <= 0 <= each.high for each in told]) < 0.97


@COMMON
@given(groups(st.one_of(ANY, st.floats(-10, 10), SMALL_INTEGERS)))
@example((np.array([1e300, -1e300]), np.array([-1e300, 1e300])))
@example((np.array([5e-324, 1e-323]), np.zeros(2)))
def test_every_number_is_finite_or_all_that_need_a_spread_are_missing(values):
    told = numbers(compare_groups(*values))
    missing = {name for name, value in told.items() if np.isnan(value)}
    assert missing in (set(), UNDEFINED)
    assert all(np.isfinite(value) for name, value in told.items() if name not in missing)
    if not missing:
        assert told["low"] <= told["difference"] <= told["high"]
        assert 0 <= told["p_value"] <= 1


@COMMON
@given(groups(st.one_of(ANY, SMALL_INTEGERS)))
def test_swapping_the_groups_turns_every_sign(values):
    told, turned = compare_groups(*values), compare_groups(*values[::-1])
    assert (told.n_first, told.mean_first) == (turned.n_second, turned.mean_second)
    np.testing.assert_array_equal(
        [told.difference, told.low, told.high, told.effect_size],
        [-turned.difference, -turned.high, -turned.low, -turned.effect_size],
    )
    np.testing.assert_array_equal([told.p_value, told.degrees_of_freedom], [turned.p_value, turned.degrees_of_freedom])


@COMMON
@given(groups(st.integers(-1000, 1000).map(float), least=2), st.integers(-480, 480))
def test_a_power_of_two_scales_all_that_has_a_unit_and_nothing_else(values, exponent):
    told, scaled = (numbers(compare_groups(*each)) for each in (values, [np.ldexp(each, exponent) for each in values]))
    for name, value in told.items():
        unit = exponent if name in WITH_A_UNIT else 0
        np.testing.assert_array_equal(np.ldexp(value, unit), scaled[name], err_msg=name)


@COMMON
@given(groups(st.integers(-100, 100).map(float), least=2), st.integers(-1000, 1000))
def test_a_shift_of_one_group_shifts_the_difference(values, shift):
    told, shifted = compare_groups(*values), compare_groups(values[0] + shift, values[1])
    for name in ("difference", "low", "high"):
        np.testing.assert_allclose(getattr(told, name) + shift, getattr(shifted, name), rtol=1e-9, atol=1e-9)
    both = compare_groups(values[0] + shift, values[1] + shift)
    np.testing.assert_allclose(told.p_value, both.p_value, rtol=1e-6)


@COMMON
@given(groups(st.sampled_from([0.0, 1.0, 2.5, 1e300, -1e-300])), st.data())
def test_a_missing_value_is_missing_in_the_result(values, data):
    values[0][data.draw(st.integers(0, values[0].size - 1))] = np.nan
    told = numbers(compare_groups(*values))
    assert told.pop("mean_second") == pytest.approx(values[1].mean())
    assert np.isnan(list(told.values())).all()
