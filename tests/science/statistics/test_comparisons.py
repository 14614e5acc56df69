"""Any values in every comparison: numbers in range, by symmetry, shift and scale; what makes no sense is refused."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from stages.science.statistics.equivalence import judge_equivalence, judge_paired_equivalence
from stages.science.statistics.groups import compare_groups
from stages.science.statistics.paired import compare_pairs
from stages.science.statistics.signed_rank import compare_ranks

COMMON = settings(derandomize=True, deadline=None, max_examples=20)
ANY = st.one_of(st.floats(-1e300, 1e300), st.floats(-10, 10), st.integers(-3, 3).map(float))
MARGINS = st.one_of(st.floats(0.01, 10), st.sampled_from([5e-324, 1e-300, 1e300]))
WITH_A_UNIT = ("first_mean", "second_mean", "difference", "hodges_lehmann", "low", "high", "margin")
TURNED = {"low": "high", "high": "low"}
TURNED |= {name: name for name in ("difference", "hodges_lehmann", "d_z", "hedges_g", "rank_biserial")}


@dataclass(frozen=True)
class Comparison:
    """How to compare two vectors, and what may be undefined together."""

    compare: Callable
    undefined: tuple[set[str], ...]
    paired: bool = True
    most: int = 6
    rounding: float = 1e-9

    def __call__(self, first, second, margin=1.0):
        if self.compare in (judge_equivalence, judge_paired_equivalence):
            return self.compare(first, second, margin)
        return self.compare(first, second)

    def values(self, elements, least=1):
        """Draw two vectors; few pairs, since SciPy walks through all their signs where differences are equal."""
        if self.paired:
            return st.integers(least, self.most).flatmap(lambda n: arrays(float, (2, n), elements=elements))
        one = arrays(float, st.integers(least, 8), elements=elements)
        return st.tuples(one, one)


INTERVAL = {"low", "high"}
PAIRS = Comparison(compare_pairs, (INTERVAL | {"d_z", "p_t", "p_wilcoxon"},))
LIMITS = INTERVAL | {"confidence"}
RANKS = Comparison(compare_ranks, (LIMITS, LIMITS | {"rank_biserial", "p_wilcoxon"}), most=7, rounding=1e-12)
GROUPS = Comparison(compare_groups, (INTERVAL | {"hedges_g", "p_welch"},), paired=False)
JUDGED = {"p_tost", "power", "n_needed"}
EQUIVALENCE = Comparison(judge_equivalence, ({"n_needed"}, JUDGED), paired=False)
PAIRED_EQUIVALENCE = Comparison(judge_paired_equivalence, ({"n_needed"}, JUDGED))
COMPARED = {"pairs": PAIRS, "ranks": RANKS, "groups": GROUPS}
NAMED = {**COMPARED, "equivalence": EQUIVALENCE, "paired equivalence": PAIRED_EQUIVALENCE}
EVERY = pytest.mark.parametrize("of", NAMED.values(), ids=NAMED)


def numbers(told):
    return {name: value for name, value in vars(told).items() if isinstance(value, float)}


def assert_in_range(of, values, margin):
    """Check that all that is told is finite, or that all that needs a spread is missing."""
    told = numbers(of(*values, margin))
    missing = {name for name, value in told.items() if np.isnan(value)}
    assert missing in (set(), *of.undefined)
    assert not np.isinf(list(told.values())).any()
    if told.keys() >= INTERVAL and "low" not in missing:
        assert told["low"] <= told.get("difference", told.get("hodges_lehmann")) <= told["high"]
    for name in told.keys() - missing:
        if name.startswith("p_") or name == "power":
            assert 0 <= told[name] <= 1
    if of is PAIRS and not missing:
        assert told["p_wilcoxon"] > 0
    if of is RANKS:
        np.testing.assert_array_equal(told["p_wilcoxon"], compare_pairs(*values).p_wilcoxon)
        assert "rank_biserial" in missing or -1 <= told["rank_biserial"] <= 1
        assert "low" in missing or 0.95 <= told["confidence"] < 1
    if "power" in told and not missing and len(values[0]) == len(values[1]):
        assert (told["n_needed"] <= len(values[0])) == (told["power"] >= 0.8)


@EVERY
@COMMON
@given(data=st.data(), margin=MARGINS)
def test_every_number_is_finite_or_all_that_need_a_spread_are_missing(of, data, margin):
    assert_in_range(of, data.draw(of.values(ANY)), margin)


@EVERY
@pytest.mark.parametrize("times", [1, 3])
@pytest.mark.parametrize(
    ("first", "second", "margin"), [([1e300, -1e300], [-1e300, 1e300], 1.0), ([5e-324, 1e-323], [0.0, 0.0], 1e300)]
)
def test_the_largest_and_the_smallest_values_are_in_range(of, first, second, margin, times):
    assert_in_range(of, (np.array(first * times), np.array(second * times)), margin)


@EVERY
@pytest.mark.parametrize("values", [([1.0], [1.0]), ([1.0, 1.0], [1.0, 1.0]), ([1.0, 1.0], [3.0, 3.0]), ([1.0], [3.0])])
def test_without_a_spread_there_is_no_test(of, values):
    told = numbers(of(*map(np.array, values)))
    assert {name for name, value in told.items() if np.isnan(value)} == of.undefined[-1]
    difference = values[0][0] - values[1][0]
    assert told.get("difference", told.get("hodges_lehmann", difference)) == difference


@EVERY
@COMMON
@given(data=st.data(), margin=MARGINS)
def test_swapping_turns_every_sign(of, data, margin):
    values = data.draw(of.values(ANY))
    told, turned = of(*values, margin), of(*values[::-1], margin)
    for name, value in numbers(told).items():
        if name in TURNED:
            np.testing.assert_array_equal(value, -getattr(turned, TURNED[name]), err_msg=name)
        elif name == "power":
            np.testing.assert_allclose(value, turned.power, atol=1e-9)
        else:
            other = {"first_mean": "second_mean", "second_mean": "first_mean"}.get(name, name)
            np.testing.assert_array_equal(value, getattr(turned, other), err_msg=name)
    if of is PAIRS:
        assert told.wins + turned.wins == np.sum(values[0] != values[1])
    if of is GROUPS:
        assert (told.n_first, told.n_second) == (turned.n_second, turned.n_first)


@EVERY
@COMMON
@given(data=st.data(), exponent=st.integers(-480, 480))
def test_a_power_of_two_scales_all_that_has_a_unit_and_nothing_else(of, data, exponent):
    values = data.draw(of.values(st.integers(-1000, 1000).map(float), least=2))
    told, scaled = of(*values, 100.0), of(*(np.ldexp(each, exponent) for each in values), np.ldexp(100.0, exponent))
    for name, value in vars(told).items():
        expected = np.ldexp(value, exponent) if name in WITH_A_UNIT else value
        np.testing.assert_array_equal(expected, getattr(scaled, name), err_msg=name)


@pytest.mark.parametrize("of", COMPARED.values(), ids=COMPARED)
@COMMON
@given(data=st.data(), shift=st.integers(-1000, 1000))
def test_a_shift_of_one_shifts_the_difference_and_one_of_both_changes_no_test(of, data, shift):
    values = data.draw(of.values(st.integers(-100, 100).map(float), least=2))
    told, shifted, both = (of(values[0] + by[0], values[1] + by[1]) for by in ((0, 0), (shift, 0), (shift, shift)))
    for name in INTERVAL | {"difference", "hodges_lehmann"} & vars(told).keys():
        found = getattr(shifted, name)
        np.testing.assert_allclose(found, getattr(told, name) + shift, rtol=of.rounding, atol=of.rounding)
    for name in numbers(told):
        if name.startswith("p_"):
            np.testing.assert_allclose(getattr(both, name), getattr(told, name), rtol=1e-6)


@EVERY
@COMMON
@given(data=st.data())
def test_a_missing_value_is_missing_in_the_result(of, data):
    values = data.draw(of.values(st.sampled_from([0.0, 1.0, 2.5, 1e300, -1e-300])))
    values[0][data.draw(st.integers(0, values[0].size - 1))] = np.nan
    told = numbers(of(*values))
    told.pop("margin", None)
    assert told.pop("second_mean", values[1].mean()) == pytest.approx(values[1].mean())
    assert np.isnan(list(told.values())).all()


@EVERY
@pytest.mark.parametrize("value", [np.inf, -np.inf, 1.7e308])
@pytest.mark.parametrize("other", [0.0, np.nan, np.inf])
def test_an_absurd_value_is_refused(of, value, other):
    with pytest.raises(ValueError, match=r"^expected values within 1e\+300, got .*$"):
        of(np.array([value, 0.0]), np.array([other, 1.0]))


@pytest.mark.parametrize(
    ("of", "shapes", "told"),
    [
        *((of, (2, 3), r"of one length, got shapes \(2,\) and \(3,\)") for of in NAMED.values() if of.paired),
        *((of, (0, 0), "of one length, got shapes") for of in NAMED.values() if of.paired),
        (EQUIVALENCE, (0, 0), "that are not empty, got shapes"),
        *((GROUPS, each, "that are not empty, got shapes") for each in ((0, 2), (2, 0), ((2, 2), 2))),
    ],
)
def test_what_is_no_pair_of_vectors_is_refused(of, shapes, told):
    with pytest.raises(ValueError, match=f"^expected two vectors {told}[^\n]*$"):
        of(*(np.zeros(shape) for shape in shapes))


@pytest.mark.parametrize("margin", [0.0, -1.0, np.nan, np.inf, 1.7e308])
@pytest.mark.parametrize("of", [EQUIVALENCE, PAIRED_EQUIVALENCE], ids=["groups", "pairs"])
def test_an_absurd_margin_is_refused(of, margin):
    with pytest.raises(ValueError, match=r"^expected a margin above 0 and within 1e\+300, got .*$"):
        of(np.zeros(3), np.ones(3), margin)
