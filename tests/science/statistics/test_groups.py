"""Welch's comparison against SciPy and statsmodels."""

import numpy as np
import pytest
from scipy import stats
from statsmodels.stats.weightstats import CompareMeans, DescrStatsW

from stages.science.statistics.groups import compare_groups


def test_agrees_with_scipy_and_statsmodels(generator):
    first, second = generator.normal(1.0, 0.3, 9), generator.normal(1.4, 0.9, 5)
    told = compare_groups(first, second)
    low, high = CompareMeans(DescrStatsW(first), DescrStatsW(second)).tconfint_diff(0.05, usevar="unequal")
    assert (told.n_first, told.n_second) == (9, 5)
    assert told.difference == pytest.approx(first.mean() - second.mean())
    assert (told.low, told.high) == (pytest.approx(low), pytest.approx(high))
    assert told.p_welch == pytest.approx(stats.ttest_ind(first, second, equal_var=False).pvalue)


def test_hedges_g_has_no_bias_and_a_sign(generator):
    first, second = generator.normal(0.8, 2.0, (40_000, 4)), generator.normal(0.0, 2.0, (40_000, 5))
    pooled = np.sqrt((3 * first.var(axis=1, ddof=1) + 4 * second.var(axis=1, ddof=1)) / 7)
    found = (first.mean(axis=1) - second.mean(axis=1)) / pooled
    told = [compare_groups(*each).hedges_g for each in zip(first[:100], second[:100], strict=True)]
    factor = told[0] / found[0]
    np.testing.assert_allclose(told, factor * found[:100], rtol=1e-9)
    assert factor * np.mean(found) == pytest.approx(0.4, abs=4 * factor * np.std(found) / np.sqrt(40_000))
    # of d = 1 with 2 + 2 values: the factor is gamma(1) / gamma(0.5)
    told = compare_groups(np.array([1.0, 3.0]), np.array([1.0, 3.0]) - np.sqrt(2))
    assert told.hedges_g == pytest.approx(1 / np.sqrt(np.pi))


def test_one_group_without_spread_leaves_the_test_of_the_other():
    values = np.array([1.0, 2.0, 4.0])
    told, test = compare_groups(values, np.zeros(5)), stats.ttest_1samp(values, 0.0)
    assert told.p_welch == pytest.approx(test.pvalue)
    assert (told.low, told.high) == pytest.approx(tuple(test.confidence_interval(0.95)))
