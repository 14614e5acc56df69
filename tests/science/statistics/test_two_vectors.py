"""Comparisons of two vectors and their power against SciPy, statsmodels, Monte Carlo and hand-made numbers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import integrate, stats
from statsmodels.stats.weightstats import CompareMeans, DescrStatsW, ttost_ind, ttost_paired

from stages.science.statistics.equivalence import judge_equivalence, judge_paired_equivalence
from stages.science.statistics.groups import compare_groups
from stages.science.statistics.paired import adjust_holm, compare_pairs
from stages.science.statistics.power import find_smallest_n, power_of_equivalence, power_of_paired_equivalence
from stages.science.statistics.sign_flips import compare_signs, fewest_trials, least_p
from stages.science.statistics.signed_rank import MOST_EXACT, _trim, compare_ranks

COMMON = settings(derandomize=True, deadline=None, max_examples=40)
DRAWS = 40_000
BAND = 4 * 0.5 / np.sqrt(DRAWS)
"""Four standard errors of a share, at most."""
UNDEFINED = ("low", "high", "d_z", "p_t", "p_wilcoxon")


def test_groups_agree_with_scipy_and_statsmodels(generator):
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


def pairs(values):
    """Draw two vectors of one length, as the rows of an array."""
    return st.integers(2, 7).flatmap(lambda n: arrays(float, (2, n), elements=values))


@COMMON
@given(pairs(st.one_of(st.floats(-10, 10), st.integers(-3, 3).map(float))))
def test_pairs_agree_with_scipy_where_differences_differ(values):
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


def test_signed_ranks_made_by_hand():
    told = compare_ranks(np.array([1.0, -2.0, 3.0, 4.0, 5.0, 6.0]), np.zeros(6))
    assert told.rank_biserial == pytest.approx((19 - 2) / 21)
    assert told.hodges_lehmann == 3.0
    # 6 pairs: all averages, which hold the median unless all signs agree
    assert (told.low, told.high, told.confidence) == (-2.0, 6.0, pytest.approx(1 - 2 / 64))
    assert told.p_wilcoxon == pytest.approx(6 / 64)
    told = compare_ranks(np.arange(5.0), np.zeros(5))  # 5 pairs bound nothing
    assert np.isnan([told.low, told.high, told.confidence]).all()
    assert (told.rank_biserial, told.p_wilcoxon) == (1.0, pytest.approx(0.125))


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


@COMMON
@given(pairs(st.integers(-5, 5).map(float)))
def test_the_effect_size_counts_ranks(values):
    told = compare_ranks(*values)
    signed = values[0] - values[1]
    if np.isnan(told.rank_biserial):
        return
    ranks = stats.rankdata(np.abs(signed[signed != 0]))
    positive, negative = (ranks[np.sign(signed[signed != 0]) == sign].sum() for sign in (1, -1))
    assert told.rank_biserial == pytest.approx((positive - negative) / (positive + negative))


@pytest.mark.parametrize("margin", [0.1, 0.5, 2.0])
def test_equivalence_agrees_with_statsmodels(generator, margin):
    first, second = generator.normal(1.0, 0.3, 8), generator.normal(1.2, 0.6, 6)
    groups, pairs = judge_equivalence(first, second, margin), judge_paired_equivalence(first[:6], second, margin)
    assert groups.p_tost == pytest.approx(ttost_ind(first, second, -margin, margin, usevar="unequal")[0], rel=1e-9)
    assert pairs.p_tost == pytest.approx(ttost_paired(first[:6], second, -margin, margin)[0], rel=1e-9)
    power = power_of_equivalence(margin, first.std(ddof=1), second.std(ddof=1), 8, 6)
    assert groups.power == pytest.approx(power, abs=1e-12)
    power = power_of_paired_equivalence(margin, np.std(first[:6] - second, ddof=1), 6)
    assert pairs.power == pytest.approx(power, abs=1e-12)
    assert groups.margin == pairs.margin == margin


@pytest.mark.parametrize("spread", [0.5, 1.0])
def test_the_smallest_n_is_the_first_with_enough_power(spread):
    values = np.array([-1.0, -0.2, 0.3, 1.4])
    told = judge_equivalence(values, values * spread, 1.0)
    sds = values.std(ddof=1), values.std(ddof=1) * spread
    powers = [power_of_equivalence(1.0, *sds, n, n) for n in range(2, 60)]
    assert told.n_needed == 2 + int(np.argmax(np.array(powers) >= 0.8))
    assert (np.diff(powers) > -1e-12).all()
    told = judge_paired_equivalence(values, 0.0 * values, 0.7)
    powers = [power_of_paired_equivalence(0.7, sds[0], n) for n in range(2, 60)]
    assert told.n_needed == 2 + int(np.argmax(np.array(powers) >= 0.8))


@pytest.mark.parametrize(
    ("sds", "ns"), [((1.0, 1.0), (4, 4)), ((1.0, 3.0), (4, 9)), ((2.0, 0.1), (2, 3)), ((0.3, 0.0), (5, 3))]
)
def test_equivalence_is_declared_as_often_as_samples_show(generator, sds, ns):
    first, second = (generator.normal(0.0, sd, (DRAWS, n)) for sd, n in zip(sds, ns, strict=True))
    parts = first.var(axis=1, ddof=1) / ns[0], second.var(axis=1, ddof=1) / ns[1]
    degrees = sum(parts) ** 2 / (parts[0] ** 2 / (ns[0] - 1) + parts[1] ** 2 / (ns[1] - 1))
    for margin in (1.0, 2.5, 6.0):
        half = stats.t.ppf(0.95, degrees) * np.sqrt(sum(parts))
        declared = np.mean(np.abs(first.mean(axis=1) - second.mean(axis=1)) < margin - half)
        assert power_of_equivalence(margin, *sds, *ns) == pytest.approx(declared, abs=BAND)


@pytest.mark.parametrize(("n", "margin"), [(2, 8.0), (5, 1.0), (12, 0.7), (40, 0.3)])
def test_paired_equivalence_is_owens_integral(n, margin):
    critical = stats.t.ppf(0.95, n - 1)

    def declare(scatter):
        half = margin - critical * scatter / np.sqrt(n)
        inside = stats.norm.cdf([half, -half], scale=1 / np.sqrt(n))
        return (inside[0] - inside[1]) * stats.chi.pdf(scatter, n - 1, scale=1 / np.sqrt(n - 1))

    owen = integrate.quad(declare, 0, margin * np.sqrt(n) / critical, epsabs=1e-11, points=[min(1.0, margin)])[0]
    assert power_of_paired_equivalence(margin, 1.0, n) == pytest.approx(owen, abs=1e-8)


@COMMON
@given(st.floats(0, 1e3), st.floats(1e-3, 1e3), st.floats(0, 1e3), st.integers(2, 50), st.integers(2, 50))
def test_powers_are_probabilities_without_side(margin, sd_first, sd_second, n_first, n_second):
    design = sd_first, sd_second, n_first, n_second
    found = power_of_equivalence(margin, *design)
    assert 0 <= found <= 1
    assert power_of_equivalence(margin, sd_second, sd_first, n_second, n_first) == pytest.approx(found, abs=1e-6)
    assert power_of_equivalence(2 * margin, *design) >= found - 1e-6
    scaled = [8 * margin, 8 * sd_first, 8 * sd_second, n_first, n_second]
    assert power_of_equivalence(*scaled) == pytest.approx(found, abs=1e-12)
    # one group without spread: the other's values against a constant
    assert power_of_equivalence(margin, sd_first, 0.0, n_first, n_second) == pytest.approx(
        power_of_paired_equivalence(margin, sd_first, n_first), abs=1e-6
    )


def test_with_very_many_values_power_is_that_of_a_normal_test():
    n, away = 1_000_000_000, 2.5
    normal = 2 * stats.norm.cdf(away - stats.norm.ppf(0.95)) - 1
    assert power_of_equivalence(away * np.sqrt(2 / n), 1.0, 1.0, n, n) == pytest.approx(normal, abs=1e-5)


@pytest.mark.parametrize("ratio", [1e-300, 1e300])
def test_extremes_are_sure(ratio):
    powers = power_of_paired_equivalence(1.0, ratio, 4), power_of_equivalence(1.0, ratio, ratio, 4, 4)
    np.testing.assert_allclose(powers, 1.0 if ratio < 1 else 0.0, atol=1e-12)


@pytest.mark.parametrize("least", [*range(2, 40), 1000, 999_999, 1_000_000])
def test_the_smallest_n_is_found(least):
    assert find_smallest_n(lambda n: float(n >= least)) == least


def test_no_n_is_found_where_none_suffices():
    assert np.isnan(find_smallest_n(lambda n: 0.79))


@pytest.mark.parametrize("two_sided", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_sign_flips_are_those_of_scipy(seed, two_sided):
    differences = np.random.default_rng(seed).normal(0.4, 1.0, size=(8, 3))
    found = compare_signs(differences, np.random.default_rng(0), two_sided)
    for column, p in zip(differences.T, found, strict=True):
        how = {"permutation_type": "samples", "n_resamples": np.inf, "alternative": "greater"}
        expected = stats.permutation_test((column,), lambda x: abs(x.mean()) if two_sided else x.mean(), **how)
        assert p == pytest.approx(expected.pvalue)


def test_no_p_of_sign_flips_is_smaller_than_it_can_be():
    all_positive = np.arange(1.0, 7.0)[:, None]
    assert compare_signs(all_positive, np.random.default_rng(0), True)[0] == least_p(6, True) == 2 / 64
    assert compare_signs(all_positive, np.random.default_rng(0))[0] == least_p(6) == 1 / 64


def test_many_sign_flips_are_sampled():
    generator = np.random.default_rng(1)
    shifted = compare_signs(generator.normal(1.0, 1.0, (30, 1)), generator)[0]
    centred = compare_signs(generator.normal(0.0, 1.0, (30, 1)), generator)[0]
    assert shifted == least_p(30)
    assert centred > 0.01


@pytest.mark.parametrize("significance", [0.2, 0.05, 0.01, 0.001])
def test_the_fewest_trials_can_be_significant_and_one_less_cannot(significance):
    fewest = fewest_trials(significance)
    assert least_p(fewest, True) <= significance < least_p(fewest - 1, True)


def test_nothing_to_flip_is_no_evidence():
    assert compare_signs(np.full((5, 1), np.nan), np.random.default_rng(0))[0] == 1.0
