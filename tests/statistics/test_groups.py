"""Welch's comparison against SciPy and statsmodels."""

import numpy as np
import pytest
from scipy import stats
from statsmodels.stats.weightstats import CompareMeans, DescrStatsW

from stages.statistics import compare_groups

UNDEFINED = {"low", "high", "degrees_of_freedom", "effect_size", "p_value"}


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
    first, second = generator.normal(0.8, 2.0, (40_000, 4)), generator.normal(0.0, 2.0, (40_000, 5))
    pooled = np.sqrt((3 * first.var(axis=1, ddof=1) + 4 * second.var(axis=1, ddof=1)) / 7)
    found = (first.mean(axis=1) - second.mean(axis=1)) / pooled
    told = [compare_groups(*each).effect_size for each in zip(first[:100], second[:100], strict=True)]
    factor = told[0] / found[0]
    np.testing.assert_allclose(told, factor * found[:100], rtol=1e-9)
    assert factor * np.mean(found) == pytest.approx(0.4, abs=4 * factor * np.std(found) / np.sqrt(40_000))
    # of d = 1 with 2 + 2 values: the factor is gamma(1) / gamma(0.5)
    told = compare_groups(np.array([1.0, 3.0]), np.array([1.0, 3.0]) - np.sqrt(2))
    assert told.effect_size == pytest.approx(1 / np.sqrt(np.pi))


@pytest.mark.parametrize(("first", "second"), [([1.0], [1.0, 2.0]), ([1.0, 1.0], [2.0, 2.0, 2.0]), ([1.0], [3.0])])
def test_no_p_value_where_there_is_none(first, second):
    told = compare_groups(np.array(first), np.array(second))
    assert {name for name, value in vars(told).items() if np.isnan(value)} == UNDEFINED
    assert told.difference == np.mean(first) - np.mean(second)


def test_one_group_without_spread_leaves_the_test_of_the_other():
    values = np.array([1.0, 2.0, 4.0])
    told, test = compare_groups(values, np.zeros(5)), stats.ttest_1samp(values, 0.0)
    assert told.p_value == pytest.approx(test.pvalue)
    assert told.degrees_of_freedom == pytest.approx(2)


def test_rates_of_false_and_of_true_findings(generator):
    """Unequal spreads and numbers, where Student's test finds far too much."""
    first, second = generator.normal(0, 3.0, (4000, 4)), generator.normal(0, 1.0, (4000, 12))
    found = stats.ttest_ind(first, second, axis=1, equal_var=False)
    low, high = found.confidence_interval(0.95)
    told = [compare_groups(*each) for each in zip(first[:200], second[:200], strict=True)]
    np.testing.assert_allclose([each.p_value for each in told], found.pvalue[:200], rtol=1e-9)
    np.testing.assert_allclose([(each.low, each.high) for each in told], np.stack([low, high], axis=1)[:200], rtol=1e-9)
    assert 0.03 < np.mean(found.pvalue < 0.05) < 0.07
    assert 0.93 < np.mean((low <= 0) & (high >= 0)) < 0.97
