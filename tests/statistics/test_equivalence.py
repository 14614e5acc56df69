"""Equivalence against statsmodels, Monte Carlo both ways, by symmetry and by scale."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from statsmodels.stats.weightstats import CompareMeans, DescrStatsW, ttost_ind, ttost_paired

from stages.statistics import (
    judge_equivalence,
    judge_paired_equivalence,
    power_of_equivalence,
    power_of_paired_equivalence,
)

COMMON = settings(derandomize=True, deadline=None, max_examples=40)
JUDGES = pytest.mark.parametrize("judge", [judge_equivalence, judge_paired_equivalence])
VALUES = st.one_of(st.floats(-1e300, 1e300), st.floats(-10, 10), st.integers(-3, 3).map(float))
MARGINS = st.one_of(st.floats(0.01, 10), st.sampled_from([5e-324, 1e-300, 1e300]))
DRAWS = 800
BAND = 4 * 0.5 / np.sqrt(DRAWS)


def pairs(values, least=1):
    return st.integers(least, 8).flatmap(lambda n: arrays(float, (2, n), elements=values))


def numbers(told):
    return {name: value for name, value in vars(told).items() if isinstance(value, float)}


@pytest.mark.parametrize("margin", [0.1, 0.5, 2.0])
def test_groups_agree_with_statsmodels(generator, margin):
    first, second = generator.normal(1.0, 0.3, 9), generator.normal(1.2, 0.6, 6)
    told = judge_equivalence(first, second, margin)
    assert told.p_value == pytest.approx(ttost_ind(first, second, -margin, margin, usevar="unequal")[0], rel=1e-9)
    low, high = CompareMeans(DescrStatsW(first), DescrStatsW(second)).tconfint_diff(0.1, usevar="unequal")
    assert (told.low, told.high) == (pytest.approx(low), pytest.approx(high))
    spreads = first.std(ddof=1), second.std(ddof=1)
    assert told.power == pytest.approx(power_of_equivalence(margin, *spreads, 9, 6), abs=1e-12)
    assert (told.n_first, told.n_second, told.margin) == (9, 6, margin)


@pytest.mark.parametrize("margin", [0.1, 0.5, 2.0])
def test_pairs_agree_with_statsmodels(generator, margin):
    first, second = generator.normal(1.0, 0.3, 8), generator.normal(1.2, 0.3, 8)
    told = judge_paired_equivalence(first, second, margin)
    assert told.p_value == pytest.approx(ttost_paired(first, second, -margin, margin)[0], rel=1e-9)
    low, high = DescrStatsW(first - second).tconfint_mean(0.1)
    assert (told.low, told.high) == (pytest.approx(low), pytest.approx(high))
    spread = np.std(first - second, ddof=1)
    assert told.power == pytest.approx(power_of_paired_equivalence(margin, spread, 8), abs=1e-12)


@pytest.mark.parametrize(("margin", "verdict"), [(0.1, "different"), (1.0, "undecided"), (9.0, "equivalent")])
@JUDGES
def test_verdicts(judge, margin, verdict):
    first = np.array([1.0, 1.2, 0.8, 1.1])
    second = np.array([0.1, 0.0, -0.1, 0.05])
    assert judge(first, second, margin).verdict == verdict
    assert judge(second, first, margin).verdict == verdict


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


@pytest.mark.parametrize(("difference", "margin"), [(0.0, 2.5), (2.5, 2.5), (0.0, 1.0)])
def test_declares_equality_as_often_as_its_power_says_and_a_difference_hardly_ever(
    generator, monkeypatch, difference, margin
):
    # the search would take most of the time
    monkeypatch.setattr("stages.statistics.equivalence.find_smallest_n", lambda power_at: None)
    ns, sds = (4, 6), (1.0, 2.0)
    told = [
        judge_equivalence(generator.normal(difference, sds[0], ns[0]), generator.normal(0, sds[1], ns[1]), margin)
        for _ in range(DRAWS)
    ]
    declared = [each.verdict == "equivalent" for each in told]
    assert declared == [each.p_value < 0.05 for each in told]
    assert declared == [-margin < each.low and each.high < margin for each in told]
    assert np.mean(declared) == pytest.approx(power_of_equivalence(margin, *sds, *ns, difference), abs=BAND)
    if difference:
        assert np.mean(declared) < 0.05 + BAND / 2


@pytest.mark.parametrize("values", [[1.0], [1.0, 1.0]])
@JUDGES
def test_no_verdict_without_a_spread(judge, values):
    told = judge(np.array(values), np.array(values), 0.5)
    assert np.isnan([told.low, told.high, told.degrees_of_freedom, told.p_value, told.power]).all()
    assert (told.verdict, told.n_needed, told.difference) == ("undefined", None, 0.0)


@JUDGES
def test_no_verdict_where_a_value_is_missing(judge):
    told = judge(np.array([1.0, np.nan, 2.0]), np.array([1.0, 2.0, 4.0]), 0.5)
    assert np.isnan([told.difference, told.low, told.high, told.p_value, told.power]).all()
    assert told.verdict == "undefined"


@COMMON
@given(pairs(VALUES), MARGINS)
@example(np.array([[1e300, -1e300], [-1e300, 1e300]]), 1.0)
@example(np.array([[5e-324, 1e-323], [0.0, 0.0]]), 1e300)
def test_every_number_is_finite_or_all_that_need_a_spread_are_missing(values, margin):
    for judge in (judge_equivalence, judge_paired_equivalence):
        told = judge(*values, margin)
        missing = {name for name, value in numbers(told).items() if np.isnan(value)}
        assert missing in (set(), {"low", "high", "degrees_of_freedom", "p_value", "power"})
        assert not np.isinf(list(numbers(told).values())).any()
        assert (told.verdict == "undefined") == bool(missing)
        if not missing:
            assert told.low <= told.difference <= told.high
            assert 0 <= told.p_value <= 1
            assert 0 <= told.power <= 1
            assert (told.n_needed is None) or (told.n_needed <= told.n_first) == (told.power >= 0.8)


@COMMON
@given(pairs(VALUES), MARGINS)
def test_swapping_turns_signs_and_keeps_the_verdict(values, margin):
    for judge in (judge_equivalence, judge_paired_equivalence):
        told, turned = judge(*values, margin), judge(*values[::-1], margin)
        np.testing.assert_array_equal(
            [told.difference, told.low, told.high, told.p_value],
            [-turned.difference, -turned.high, -turned.low, turned.p_value],
        )
        np.testing.assert_allclose(told.power, turned.power, atol=1e-9)
        assert told.verdict == turned.verdict


@COMMON
@given(pairs(st.integers(-1000, 1000).map(float), least=2), st.integers(-400, 400))
def test_a_power_of_two_scales_all_that_has_a_unit_and_nothing_else(values, exponent):
    for judge in (judge_equivalence, judge_paired_equivalence):
        told, scaled = judge(*values, 100.0), judge(*np.ldexp(values, exponent), np.ldexp(100.0, exponent))
        for name, value in numbers(told).items():
            unit = exponent if name in ("difference", "low", "high", "margin") else 0
            np.testing.assert_array_equal(np.ldexp(value, unit), getattr(scaled, name), err_msg=name)
        assert (told.verdict, told.n_needed) == (scaled.verdict, scaled.n_needed)


@COMMON
@given(pairs(st.floats(-10, 10), least=2), st.floats(0.01, 10))
def test_a_wider_margin_makes_equivalence_likelier(values, margin):
    for judge in (judge_equivalence, judge_paired_equivalence):
        told, wider = judge(*values, margin), judge(*values, 2 * margin)
        if told.verdict != "undefined":
            assert wider.p_value <= told.p_value
            assert wider.power >= told.power - 1e-9


@pytest.mark.parametrize("margin", [0.0, -1.0, np.nan, np.inf, 1.7e308])
@JUDGES
def test_an_absurd_margin_is_refused(judge, margin):
    with pytest.raises(ValueError, match=r"^expected a margin above 0 and within 1e\+300, got .*$"):
        judge(np.zeros(3), np.ones(3), margin)


@JUDGES
def test_absurd_values_are_refused(judge):
    with pytest.raises(ValueError, match=r"^expected values within 1e\+300, got inf$"):
        judge(np.array([np.inf, 1.0]), np.ones(2), 1.0)
    with pytest.raises(ValueError, match=r"^expected two vectors that are not empty, got shapes .*$"):
        judge(np.zeros(0), np.zeros(0), 1.0)


def test_pairs_pair_up():
    with pytest.raises(ValueError, match=r"two vectors of one length, got shapes \(2,\) and \(3,\)"):
        judge_paired_equivalence(np.zeros(2), np.zeros(3), 1.0)
