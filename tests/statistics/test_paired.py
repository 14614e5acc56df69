"""Paired comparisons against SciPy, statsmodels and hand-made numbers."""

import numpy as np
import pytest
from scipy import stats
from statsmodels.stats.weightstats import DescrStatsW

from stages.statistics import adjust_benjamini_yekutieli, adjust_holm, compare_pairs


def test_agrees_with_scipy_and_statsmodels(generator):
    first, second = generator.normal(1.0, 0.3, 8), generator.normal(1.4, 0.3, 8)
    told = compare_pairs(first, second)
    low, high = DescrStatsW(first - second).tconfint_mean(0.05)
    assert told.n == 8
    assert told.difference == pytest.approx(np.mean(first - second))
    assert (told.low, told.high) == (pytest.approx(low), pytest.approx(high))
    assert told.t_p_value == pytest.approx(stats.ttest_1samp(first - second, 0.0).pvalue)
    assert told.effect_size == pytest.approx(np.mean(first - second) / np.std(first - second, ddof=1))
    assert told.wins == np.sum(first < second)


def test_exact_wilcoxon_of_eight_wins_is_two_in_two_to_the_eighth():
    told = compare_pairs(np.arange(8.0), np.arange(8.0) + np.linspace(1, 2, 8))
    assert told.wilcoxon_p_value == pytest.approx(2 / 2**8)
    assert told.wins == 8


@pytest.mark.parametrize("values", [[1.0], [1.0, 1.0]])
def test_no_p_value_where_there_is_none(values):
    told = compare_pairs(np.array(values), np.array(values))
    assert np.isnan([told.low, told.high, told.effect_size, told.t_p_value, told.wilcoxon_p_value]).all()
    assert told.difference == 0


def test_refuses_what_does_not_pair_up():
    with pytest.raises(ValueError, match=r"two vectors of one length, got shapes \(2,\) and \(3,\)"):
        compare_pairs(np.zeros(2), np.zeros(3))


def test_holm_steps_down_and_keeps_nan():
    adjusted = adjust_holm(np.array([0.01, np.nan, 0.04, 0.03]))
    np.testing.assert_allclose(adjusted, [0.03, np.nan, 0.06, 0.06])


def test_false_positive_rate_is_the_nominal_one(generator):
    found = [compare_pairs(*generator.normal(size=(2, 8))).t_p_value < 0.05 for _ in range(2000)]
    assert 0.035 < np.mean(found) < 0.067


def test_benjamini_yekutieli_divides_by_the_harmonic_sum_and_keeps_nan():
    p_values = np.array([0.01, np.nan, 0.04, 0.03])
    adjusted = adjust_benjamini_yekutieli(p_values)
    np.testing.assert_allclose(adjusted, np.array([0.03, np.nan, 0.04, 0.04]) * (1 + 1 / 2 + 1 / 3))
    np.testing.assert_allclose(adjusted[[0, 2, 3]], stats.false_discovery_control(p_values[[0, 2, 3]], method="by"))


@pytest.mark.parametrize("p_values", [[], [np.nan], [0.2], [1.0, 1.0]])
def test_nothing_to_adjust(p_values):
    for adjust in (adjust_holm, adjust_benjamini_yekutieli):
        np.testing.assert_array_equal(adjust(np.array(p_values)), p_values)
