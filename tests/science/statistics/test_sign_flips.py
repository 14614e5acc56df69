"""The sign-flip test against SciPy's exact permutation test."""

import numpy as np
import pytest
from scipy.stats import permutation_test

from stages.science.statistics.sign_flips import compare_signs, least_p


@pytest.mark.parametrize("two_sided", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_p_is_that_of_scipy(seed, two_sided):
    differences = np.random.default_rng(seed).normal(0.4, 1.0, size=(8, 3))
    found = compare_signs(differences, np.random.default_rng(0), two_sided)
    for column, p in zip(differences.T, found, strict=True):
        expected = permutation_test(
            (column,),
            lambda x: abs(x.mean()) if two_sided else x.mean(),
            permutation_type="samples",
            n_resamples=np.inf,
            alternative="greater",
        )
        assert p == pytest.approx(expected.pvalue)


def test_it_is_never_smaller_than_it_can_be():
    all_positive = np.arange(1.0, 7.0)[:, None]
    assert compare_signs(all_positive, np.random.default_rng(0), True)[0] == least_p(6, True) == 2 / 64
    assert compare_signs(all_positive, np.random.default_rng(0))[0] == least_p(6) == 1 / 64


def test_many_trials_are_sampled():
    generator = np.random.default_rng(1)
    shifted = compare_signs(generator.normal(1.0, 1.0, (30, 1)), generator)[0]
    centred = compare_signs(generator.normal(0.0, 1.0, (30, 1)), generator)[0]
    assert shifted == least_p(30)
    assert centred > 0.01


def test_nothing_to_compare_is_no_evidence():
    assert compare_signs(np.full((5, 1), np.nan), np.random.default_rng(0))[0] == 1.0
