"""The noise model against dense covariances and simulated noise."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from stages.science.output_channels.noise import Noise, estimate_noise, log_density, whiten
from tests.science.discrepancy.searches import DISCREPANCY

NOISE = Noise(0.7, 0.5, 0.05, 0.9, 1.2)
STEP_S = 0.01


def covariance(samples, noise):
    lag = np.abs(np.subtract.outer(np.arange(samples), np.arange(samples))) * STEP_S
    quick = noise.quick**2 * np.exp(-lag / noise.quick_s)
    return quick + noise.slow**2 * np.exp(-lag / noise.slow_s) + noise.white**2 * np.eye(samples)


def estimate(residual):
    return estimate_noise(residual, np.ones(residual.shape, dtype=bool), STEP_S, DISCREPANCY.detection)


def test_density_is_that_of_the_dense_covariance_and_what_is_not_present_counts_for_nothing():
    generator = np.random.default_rng(1)
    residual = generator.standard_normal((60, 3))
    present = generator.random((60, 3)) > 0.2
    known = np.where(present, residual, 1e6)
    found = log_density(known, present, NOISE, STEP_S)
    assert not whiten(known[:, :, None], present, NOISE, STEP_S)[~present].any()
    for k in range(3):
        kept = present[:, k]
        sigma = covariance(60, NOISE)[np.ix_(kept, kept)]
        dense = multivariate_normal(cov=sigma).logpdf(residual[kept, k]) + 0.5 * kept.sum() * np.log(2.0 * np.pi)
        assert found[k] == pytest.approx(dense, rel=1e-9)


def test_whitening_is_linear_and_gives_the_same_quadratic_form():
    generator = np.random.default_rng(2)
    values = generator.standard_normal((50, 2, 4))
    present = np.ones((50, 2), dtype=bool)
    white = whiten(values, present, NOISE, STEP_S)
    inverse = np.linalg.inv(covariance(50, NOISE))
    for k in range(2):
        np.testing.assert_allclose(white[:, k].T @ white[:, k], values[:, k].T @ inverse @ values[:, k], rtol=1e-8)
    both = whiten(values[:, :, :1] + 2.0 * values[:, :, 1:2], present, NOISE, STEP_S)
    np.testing.assert_allclose(both, white[:, :, :1] + 2.0 * white[:, :, 1:2], atol=1e-12)


def test_the_constants_of_simulated_noise_are_found_and_too_few_samples_are_refused():
    generator = np.random.default_rng(4)
    factor = np.linalg.cholesky(covariance(500, NOISE))
    residual = factor @ generator.standard_normal((500, 30))
    found, present = estimate(residual), np.ones(residual.shape, dtype=bool)
    assert found.white == pytest.approx(NOISE.white, rel=0.1)
    assert np.hypot(found.quick, found.slow) == pytest.approx(np.hypot(NOISE.quick, NOISE.slow), rel=0.2)
    own, true = (log_density(residual, present, each, STEP_S).sum() for each in (found, NOISE))
    assert own > true - 3.0
    with pytest.raises(ValueError, match="at least 10 samples, got 6"):
        estimate(np.ones((3, 2)))


def test_some_of_the_roughness_is_always_taken_for_white():
    coloured = NOISE._replace(white=0.0, slow=1e-6)
    residual = np.linalg.cholesky(covariance(400, coloured)) @ np.random.default_rng(6).standard_normal((400, 10))
    rough = np.sqrt((np.diff(residual, n=2, axis=0) ** 2).mean() / 6.0)
    assert estimate(residual).white == pytest.approx(0.5 * rough, rel=0.02)
