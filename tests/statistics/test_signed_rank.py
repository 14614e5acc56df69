"""Signed ranks against SciPy, by enumeration, by symmetry and by scale."""

from itertools import product

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats

from stages.statistics import compare_pairs, compare_ranks
from stages.statistics.signed_rank import MOST_EXACT, _trim

COMMON = settings(derandomize=True, deadline=None, max_examples=40)
VALUES = st.one_of(st.floats(-1e300, 1e300), st.floats(-10, 10), st.integers(-3, 3).map(float))
DIGITS = 1e-12


def pairs(values, least=1):
    return st.integers(least, 12).flatmap(lambda n: arrays(float, (2, n), elements=values))


def numbers(told):
    return {name: value for name, value in vars(told).items() if name != "n"}


def test_hand_made_numbers():
    told = compare_ranks(np.array([1.0, -2.0, 3.0, 4.0, 5.0, 6.0]), np.zeros(6))
    assert told.effect_size == pytest.approx((19 - 2) / 21)
    assert told.estimate == 3.0
    # 6 pairs: all averages, which hold the median unless all signs agree
    assert (told.low, told.high, told.confidence) == (-2.0, 6.0, pytest.approx(1 - 2 / 64))
    assert told.p_value == pytest.approx(6 / 64)


@pytest.mark.parametrize("n", [6, 9, 12])
def test_the_interval_is_the_test_inverted(generator, n):
    """A typical difference is within where SciPy's exact test does not reject it, at the level that n allows."""
    first = generator.normal(0.4, 1.0, n)
    told = compare_ranks(first, np.zeros(n))
    span = told.high - told.low
    for place in (told.low, told.high):
        inside, outside = (place + step * span * 1e-9 for step in ((1, -1) if place == told.low else (-1, 1)))
        assert stats.wilcoxon(first - inside).pvalue > 0.05
        assert stats.wilcoxon(first - outside).pvalue <= 0.05


@pytest.mark.parametrize("n", [1, 2, 5, 6, 7, 10])
def test_rank_sums_are_counted(n):
    sums = np.array(list(product([0, 1], repeat=n))) @ np.arange(1, n + 1)
    below = np.array([np.mean(sums <= each) for each in range(sums.max() + 1)])
    found, tail = _trim(n)
    assert found == int((below <= 0.025).sum()) - 1
    assert np.isnan(tail) if n < 6 else tail == pytest.approx(below[found])


def test_counted_and_normal_rank_sums_meet(monkeypatch):
    exact = _trim.__wrapped__(MOST_EXACT)
    monkeypatch.setattr("stages.statistics.signed_rank.MOST_EXACT", 10)
    near = _trim.__wrapped__(MOST_EXACT)
    assert abs(exact[0] - near[0]) <= 1
    assert exact[1] == pytest.approx(near[1], abs=2e-5)  # one rank sum more has 7e-5


def test_the_interval_holds_the_typical_difference_as_often_as_it_says(generator):
    for n in (8, 300):
        draws = generator.laplace(2.0, 1.0, (1000 if n == 8 else 200, n))
        told = [compare_ranks(each, np.zeros(n)) for each in draws]
        held = np.mean([each.low <= 2.0 <= each.high for each in told])
        assert held == pytest.approx(told[0].confidence, abs=4 * np.sqrt(0.05 * 0.95 / len(draws)))
        assert np.mean([each.estimate for each in told]) == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("values", [[1.0], [1.0, 1.0]])
def test_nothing_where_nothing_differs(values):
    told = compare_ranks(np.array(values) + 1, np.array(values))
    assert told.estimate == 1.0
    assert np.isnan([told.low, told.high, told.confidence, told.effect_size, told.p_value]).all()


def test_five_pairs_bound_nothing():
    told = compare_ranks(np.arange(5.0), np.zeros(5))
    assert np.isnan([told.low, told.high, told.confidence]).all()
    assert told.effect_size == 1.0
    assert told.p_value == pytest.approx(0.125)


def test_a_missing_value_is_missing_in_the_result():
    assert np.isnan(list(numbers(compare_ranks(np.array([1.0, np.nan, 3.0]), np.zeros(3))).values())).all()


@COMMON
@given(pairs(VALUES))
@example(np.array([[1e300, -1e300] * 3, [-1e300, 1e300] * 3]))
def test_every_number_is_finite_or_undefined_and_in_its_range(values):
    told = compare_ranks(*values)
    missing = {name for name, value in numbers(told).items() if np.isnan(value)}
    interval = {"low", "high", "confidence"}
    assert missing in (set(), interval, {*interval, "effect_size", "p_value"})
    assert not np.isinf(list(numbers(told).values())).any()
    if "low" not in missing:
        assert told.low <= told.estimate <= told.high
        assert 0.95 <= told.confidence < 1
    if "p_value" not in missing:
        assert -1 <= told.effect_size <= 1
    pairwise = compare_pairs(*values)
    np.testing.assert_array_equal(told.p_value, pairwise.wilcoxon_p_value)


@COMMON
@given(pairs(VALUES))
def test_swapping_the_methods_turns_every_sign(values):
    told, turned = compare_ranks(*values), compare_ranks(*values[::-1])
    np.testing.assert_array_equal(
        [told.estimate, told.low, told.high, told.effect_size, told.p_value],
        [-turned.estimate, -turned.high, -turned.low, -turned.effect_size, turned.p_value],
    )


@COMMON
@given(pairs(st.integers(-1000, 1000).map(float), least=2), st.integers(-400, 400), st.integers(-50, 50))
def test_scale_and_shift(values, exponent, shift):
    told, scaled = numbers(compare_ranks(*values)), numbers(compare_ranks(*np.ldexp(values, exponent)))
    for name, value in told.items():
        unit = exponent if name in ("estimate", "low", "high") else 0
        np.testing.assert_array_equal(np.ldexp(value, unit), scaled[name], err_msg=name)
    shifted = numbers(compare_ranks(values[0] + shift, values[1]))
    for name in ("estimate", "low", "high"):
        np.testing.assert_allclose(shifted[name], told[name] + shift, rtol=DIGITS, atol=DIGITS)


@COMMON
@given(pairs(st.integers(-5, 5).map(float), least=2))
def test_effect_size_counts_ranks(values):
    told = compare_ranks(*values)
    signed = values[0] - values[1]
    if np.isnan(told.effect_size):
        return
    ranks = stats.rankdata(np.abs(signed[signed != 0]))
    positive, negative = (ranks[np.sign(signed[signed != 0]) == sign].sum() for sign in (1, -1))
    assert told.effect_size == pytest.approx((positive - negative) / (positive + negative))


@pytest.mark.parametrize(
    ("first", "second", "message"),
    [
        (np.zeros(2), np.zeros(3), r"^expected two vectors of one length, got shapes \(2,\) and \(3,\)$"),
        (np.zeros(0), np.zeros(0), r"^expected two vectors of one length, got .*$"),
        (np.array([np.inf]), np.zeros(1), r"^expected values within 1e\+300, got inf$"),
        (np.zeros(4001), np.zeros(4001), r"^expected at most 4000 pairs, got 4001$"),
    ],
)
def test_absurd_values_are_refused(first, second, message):
    with pytest.raises(ValueError, match=message):
        compare_ranks(first, second)
