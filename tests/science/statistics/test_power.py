"""Power against Owen's integral, Monte Carlo and its own limits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate, stats

from stages.science.statistics.power import find_smallest_n, power_of_equivalence, power_of_paired_equivalence

COMMON = settings(derandomize=True, deadline=None, max_examples=60)
DRAWS = 40_000
BAND = 4 * 0.5 / np.sqrt(DRAWS)
"""Four standard errors of a share, at most."""


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
