"""Any signal and schedule: derivatives of polynomials, errors by their definition, commands and postures in range."""

from fractions import Fraction
from itertools import permutations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from stages.science.signals.filtering import differentiate, window_length
from stages.science.signals.measures import error_rate, rmse
from stages.science.signals.trajectories import pressure_profiles, reach_postures

COMMON = settings(derandomize=True, deadline=None, max_examples=100)
RATES = st.sampled_from([0.5, 10.0, 100.0, 250.0, 1e4])


@COMMON
@given(
    st.integers(1, 5).flatmap(lambda order: arrays(float, (order + 1, 2), elements=st.floats(-3, 3))),
    RATES,
    st.integers(0, 31),
    st.integers(0, 40),
)
def test_polynomials_of_the_order_are_differentiated_exactly(coefficients, rate, window, extra):
    order = len(coefficients) - 1
    length = window_length(rate, window / rate, order)
    assert length % 2 == 1
    assert length > order
    samples = np.arange(length + extra) / (length + extra)
    signal = np.polynomial.polynomial.polyval(samples, coefficients).T
    per_s = rate / len(samples)
    truth = np.polynomial.polynomial.polyval(samples, np.polynomial.polynomial.polyder(coefficients)).T * per_s
    found = differentiate(signal, rate, window / rate, order)
    # a slope of rounding: eps of the signal over one sample, by the weights of the ends' polynomial
    assert np.abs(found - truth).max() <= 1e-11 * rate * (1 + np.abs(signal).max()) * 4.0**order


def test_the_window_is_the_odd_number_nearest_to_its_length_that_holds_the_polynomial():
    assert [window_length(rate, 0.05, 2) for rate in (250.0, 100.0, 10.0)] == [13, 5, 3]


@COMMON
@given(st.integers(1, 4), RATES, st.floats(0, 0.2))
def test_a_signal_shorter_than_the_window_is_refused(order, rate, window_s):
    length = window_length(rate, min(window_s, 50 / rate), order)
    with pytest.raises(ValueError, match=f"expected at least {length} samples"):
        differentiate(np.zeros(length - 1), rate, min(window_s, 50 / rate), order)
    assert (differentiate(np.zeros((length, 2, 2)), rate, min(window_s, 50 / rate), order) == 0).all()


@pytest.mark.parametrize(("rate", "order"), [(0.0, 2), (-1.0, 2), (np.nan, 2), (np.inf, 2), (100.0, 0), (100.0, -1)])
def test_an_order_or_rate_without_sense_is_refused(rate, order):
    with pytest.raises(ValueError, match="expected an order of at least 1 and a positive rate"):
        differentiate(np.zeros(50), rate, 0.05, order)


FORCES = st.one_of(st.floats(-1e150, 1e150), st.floats(-100, 100), st.sampled_from([0.0, 1e-200, 5e-324]))


@COMMON
@given(st.integers(1, 8).flatmap(lambda n: arrays(float, (2, n), elements=FORCES)))
@example(np.array([[1e150, -1e150], [-1e150, 1e150]]))
@example(np.array([[1e-200, 2e-200], [0.0, 0.0]]))
@example(np.array([[1e-322, 0.0], [0.0, 0.0]]))
def test_the_error_is_its_definition_in_exact_arithmetic(values):
    predicted, measured = values
    exact = sum((Fraction(p) - Fraction(m)) ** 2 for p, m in zip(predicted, measured, strict=True)) / len(measured)
    found = rmse(predicted, measured)
    # squares of exact differences, compared as fractions: no overflow, no root; 1e-14 is the mean's rounding, and the
    # root is rounded to a multiple of 5e-324, by half of it at most
    assert abs(Fraction(found) ** 2 - exact) <= Fraction(1e-14) * exact + Fraction(5e-324) * Fraction(found + 5e-324)
    assert rmse(measured, predicted) == found
    if measured.max() <= 1e-150:
        with pytest.raises(ValueError, match="expected a positive measured force to divide by"):
            error_rate(predicted, measured)
    else:
        assert np.isfinite(error_rate(predicted, measured))
        assert error_rate(predicted, measured) == pytest.approx(found / measured.max())
        assert error_rate(measured, measured) == 0.0


@pytest.mark.parametrize("value", [np.inf, -np.inf, 1e200])
def test_absurd_forces_are_refused(value):
    with pytest.raises(ValueError, match=r"one shape, not empty; got \(2,\) and \(3,\)"):
        rmse([1.0, 2.0], [1.0, 2.0, value])
    for pair in permutations([[value, 1.0], [1.0, 1.0]]), permutations([[1.0, value], [1.0, 1.0]]):
        for predicted, measured in pair:
            with pytest.raises(ValueError, match=r"expected values within 1e\+150"):
                error_rate(predicted, measured)


@st.composite
def ranges(draw):
    """Draw low and high of one to four columns."""
    count = draw(st.integers(1, 4))
    bound = st.one_of(st.floats(-1e6, 1e6), st.integers(-2, 2).map(float), st.sampled_from([0.1, 0.30000000000000004]))
    return np.sort(draw(arrays(float, (2, count), elements=bound)), axis=0)


SPANS = st.tuples(st.floats(0, 0.5), st.floats(0, 0.5)).map(sorted).map(tuple)
SEEDS = st.integers(0, 2**32 - 1)


@COMMON
@given(SEEDS, ranges(), st.integers(0, 300), RATES, SPANS, SPANS, st.floats(0, 1))
def test_pressures_and_postures_are_always_within_their_ranges(seed, bounds, samples, rate, first_s, second_s, share):
    def press():
        source = np.random.default_rng(seed)
        times = {"hold_s": first_s, "transition_s": second_s, "step_share": share}
        return pressure_profiles(source, *bounds, samples, rate, **times)

    def reach():
        return reach_postures(np.random.default_rng(seed), *bounds, samples, rate, first_s, second_s)

    for draw in (press, reach):
        found = draw()
        assert found.shape == (samples, bounds.shape[1])
        assert ((found >= bounds[0]) & (found <= bounds[1])).all()
        assert draw().tobytes() == found.tobytes()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"low": [1.0, 3.0]}, "low <= high for each"),
        ({"low": [0.0, np.nan]}, "low <= high for each"),
        ({"high": [1.0, np.inf]}, "low <= high for each"),
        ({"rate": 0.0}, "sampling_rate_hz: expected a positive rate, got 0.0"),
        ({"rate": np.nan}, "sampling_rate_hz: expected a positive rate, got nan"),
        ({"first": (1.0, 0.5)}, "_s: expected 0 <= shortest <= longest, got 1.0 and 0.5 s"),
        ({"second": (-1.0, 0.5)}, "_s: expected 0 <= shortest <= longest, got -1.0 and 0.5 s"),
        ({"second": (0.0, np.nan)}, "_s: expected 0 <= shortest <= longest, got 0.0 and nan s"),
    ],
)
def test_ranges_and_times_without_sense_are_refused(change, told, generator):
    given = {"low": [0.0, 0.0], "high": [1.0, 2.0], "rate": 100.0, "first": (0.1, 0.2), "second": (0.1, 0.2)} | change
    low, high, rate, first, second = given.values()
    with pytest.raises(ValueError, match=told):
        reach_postures(generator, low, high, 50, rate, first, second)
    with pytest.raises(ValueError, match=told):
        pressure_profiles(generator, low, high, 50, rate, hold_s=first, transition_s=second, step_share=0.5)
    with pytest.raises(ValueError, match=r"step_share: expected a share between 0 and 1, got 1.5"):
        pressure_profiles(generator, [4], [5], 100, 100.0, hold_s=(0, 1), transition_s=(0, 1), step_share=1.5)


def test_a_derivative_reduces_noise(generator):
    noise = generator.standard_normal((2000, 1))
    raw = np.gradient(noise, 1 / 250, axis=0)
    assert differentiate(noise, 250.0, 0.05, 2).std() < 0.15 * raw.std()
