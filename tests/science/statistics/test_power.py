"""Power against Owen's integral, Monte Carlo and its own limits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate, stats

from stages.science.statistics.power import (
    find_smallest_n,
    power_of_equivalence,
    power_of_paired_equivalence,
)

COMMON = settings(derandomize=True, deadline=None, max_examples=60)
DRAWS = 40_000
BAND = 4 * 0.5 / np.sqrt(DRAWS)
"""Four standard errors of a share, at most."""


def simulate_groups(generator, sds, ns, difference):
    """Return many samples of two groups, their differences, Welch's standard errors and degrees of freedom."""
    first = generator.normal(difference, sds[0], (DRAWS, ns[0]))
    second = generator.normal(0.0, sds[1], (DRAWS, ns[1]))
    parts = first.var(axis=1, ddof=1) / ns[0], second.var(axis=1, ddof=1) / ns[1]
    degrees = sum(parts) ** 2 / (parts[0] ** 2 / (ns[0] - 1) + parts[1] ** 2 / (ns[1] - 1))
    return (first, second), first.mean(axis=1) - second.mean(axis=1), np.sqrt(sum(parts)), degrees


@pytest.mark.parametrize(
    ("sds", "ns", "difference"),
    [((1.0, 1.0), (4, 4), 0.0), ((1.0, 1.0), (4, 4), 2.0), ((1.0, 3.0), (4, 9), 2.0), ((2.0, 0.1), (2, 3), 5.0)],
)
def test_equivalence_is_declared_as_often_as_samples_show(generator, sds, ns, difference):
    _, found, error, degrees = simulate_groups(generator, sds, ns, difference)
    for margin in (1.0, 2.5, 6.0):
        declared = np.mean(np.abs(found) < margin - stats.t.ppf(0.95, degrees) * error)
        assert power_of_equivalence(margin, *sds, *ns, difference) == pytest.approx(declared, abs=BAND)


@pytest.mark.parametrize(("n", "margin", "difference"), [(2, 8.0, 0.0), (5, 1.0, 0.3), (12, 0.7, 0.0), (40, 0.3, 0.3)])
def test_paired_equivalence_is_owens_integral(n, margin, difference):
    critical = stats.t.ppf(0.95, n - 1)

    def declare(scatter):
        half = margin - critical * scatter / np.sqrt(n)
        inside = stats.norm.cdf([half - difference, -half - difference], scale=1 / np.sqrt(n))
        return (inside[0] - inside[1]) * stats.chi.pdf(scatter, n - 1, scale=1 / np.sqrt(n - 1))

    owen = integrate.quad(declare, 0, margin * np.sqrt(n) / critical, epsabs=1e-11, points=[min(1.0, margin)])[0]
    assert power_of_paired_equivalence(margin, 1.0, n, difference) == pytest.approx(owen, abs=1e-8)


def test_at_the_margin_equivalence_is_declared_at_most_at_its_level():
    for n in (3, 8, 50):
        assert power_of_paired_equivalence(1.0, 1.0, n, difference=1.0) <= 0.05 + 1e-9
        assert power_of_equivalence(1.0, 1.0, 1.0, n, n, difference=1.0) <= 0.051
    assert power_of_paired_equivalence(1.0, 1.0, 50, difference=1.0) == pytest.approx(0.05, abs=1e-6)


@COMMON
@given(
    st.floats(0, 1e3),
    st.floats(-1e3, 1e3),
    st.floats(1e-3, 1e3),
    st.floats(0, 1e3),
    st.integers(2, 50),
    st.integers(2, 50),
)
def test_powers_are_probabilities_without_side(margin, difference, sd_first, sd_second, n_first, n_second):
    design = sd_first, sd_second, n_first, n_second
    turned = sd_second, sd_first, n_second, n_first
    found = power_of_equivalence(margin, *design, difference)
    assert 0 <= found <= 1
    assert power_of_equivalence(margin, *turned, -difference) == pytest.approx(found, abs=1e-6)
    assert power_of_equivalence(2 * margin, *design, difference) >= found - 1e-6
    scaled = [8 * margin, 8 * sd_first, 8 * sd_second, n_first, n_second, 8 * difference]
    assert power_of_equivalence(*scaled) == pytest.approx(found, abs=1e-12)
    # one group without spread: the other's values against a constant
    assert power_of_equivalence(margin, sd_first, 0.0, n_first, n_second, difference) == pytest.approx(
        power_of_paired_equivalence(margin, sd_first, n_first, difference), abs=1e-6
    )


def test_with_very_many_values_power_is_that_of_a_normal_test():
    n, away = 1_000_000_000, 2.5
    normal = 2 * stats.norm.cdf(away - stats.norm.ppf(0.95)) - 1
    assert power_of_equivalence(away * np.sqrt(2 / n), 1.0, 1.0, n, n) == pytest.approx(normal, abs=1e-5)


@pytest.mark.parametrize("ratio", [1e-300, 1e300])
def test_extremes_are_sure(ratio):
    powers = power_of_paired_equivalence(1.0, ratio, 4), power_of_equivalence(1.0, ratio, ratio, 4, 4)
    np.testing.assert_allclose(powers, 1.0 if ratio < 1 else 0.0, atol=1e-12)


def test_far_margins_and_differences_still_meet():
    assert power_of_paired_equivalence(1e300, 1e-300, 4, 1e300) == pytest.approx(0.05, abs=1e-6)
    assert power_of_equivalence(1e300, 1e-300, 1e-300, 4, 4, -1e300) == pytest.approx(0.05, abs=0.01)


@pytest.mark.parametrize("least", [*range(2, 40), 1000, 999_999, 1_000_000])
def test_the_smallest_n_is_found(least):
    assert find_smallest_n(lambda n: float(n >= least)) == least


def test_no_n_is_found_where_none_suffices():
    assert find_smallest_n(lambda n: 0.79) is None


@pytest.mark.parametrize(
    "call",
    [
        lambda: power_of_paired_equivalence(1.0, 0.0, 4),
        lambda: power_of_paired_equivalence(np.nan, 1.0, 4),
        lambda: power_of_equivalence(1.0, 0.0, 0.0, 4, 4),
        lambda: power_of_equivalence(1.0, -1.0, 1.0, 4, 4),
        lambda: power_of_equivalence(-1.0, 1.0, 1.0, 4, 4),
        lambda: power_of_paired_equivalence(np.inf, 1.0, 4),
    ],
)
def test_absurd_designs_are_refused(call):
    with pytest.raises(ValueError, match=r"^expected a finite difference, a margin of at least 0 and a positive .*$"):
        call()


@pytest.mark.parametrize("n", [1, 0, -4, 2.5, np.nan, 1_000_000_001])
def test_absurd_numbers_of_values_are_refused(n):
    with pytest.raises(ValueError, match=r"^expected 2 to 1000000000 values, got 4, .*$"):
        power_of_equivalence(1.0, 1.0, 1.0, 4, n)
