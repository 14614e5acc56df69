"""Bands hold the share of new samples that they say, and their parts are those of linear regression."""

import numpy as np
import pytest
from scipy.stats import norm

from stages.science.discrepancy.bands import find_band, measure_coverage
from stages.science.discrepancy.resampling import resample
from stages.science.output_channels.fitting import Model, fit
from stages.science.output_channels.noise import make_plain
from tests.science.discrepancy.toys import make_toy

NOISE = 0.1


def band_of(seed, trials=30, fitted=20, **toy):
    """A toy's fit to its first trials, the band of all, and which were fitted."""
    output = make_toy(seed, noise=NOISE, trials=trials, **toy)
    learnt = np.arange(trials) < fitted
    plain = make_plain(NOISE)
    model = Model(output)
    values = fit(Model(output.take(list(range(fitted)))), plain, model.start).values
    still = fit(model, plain, values, iterations=0)
    return still, learnt, find_band(still, learnt, resample(fitted, 2000, np.random.default_rng(seed)))


def cover(still, learnt, band):
    inside = np.abs(still.residual) <= band.reach(0.95)
    return inside[:, ~learnt].mean()


@pytest.mark.parametrize("wander", [0.0, 0.3])
def test_they_hold_what_they_say_of_trials_that_were_not_fitted(wander):
    shares = [cover(*band_of(seed, wander=wander)) for seed in range(20)]
    assert np.mean(shares) == pytest.approx(0.95, abs=0.02)


def test_the_parts_are_those_of_least_squares():
    still, learnt, band = band_of(1)
    columns = still.slopes[:, learnt].reshape(-1, still.slopes.shape[2])
    spread = NOISE * np.sqrt(
        np.einsum("tkp,pq,tkq->tk", still.slopes, np.linalg.inv(columns.T @ columns), still.slopes)
    )
    np.testing.assert_allclose(band.simulated.mean(), spread.mean(), rtol=0.25)
    assert band.left == pytest.approx(NOISE, rel=0.03)
    half = norm.ppf(0.975) * np.sqrt(band.simulated**2 + band.left**2)
    np.testing.assert_allclose(band.reach(0.95), half)


def test_a_map_that_takes_half_of_what_is_left_takes_half_of_what_values_wander():
    _, _, band = band_of(1)
    beside = band.beside(0.5 * band.left)
    np.testing.assert_allclose(beside.reach(0.9), 0.5 * band.reach(0.9))
    np.testing.assert_array_equal(band.beside(2.0 * band.left).simulated, band.simulated)


def test_coverage_is_the_share_of_samples_with_an_interval_over_trials():
    inside, counts = np.array([90.0, 50.0, 0.0]), np.array([100.0, 50.0, 0.0])
    told = measure_coverage(inside, counts, resample(3, 1000, np.random.default_rng(0)), 0.95)
    assert told["coverage"] == pytest.approx(140.0 / 150.0)
    assert (told["low"], told["high"]) == pytest.approx((0.0, 1.0), abs=0.11)
    alone = measure_coverage(inside[:1], counts[:1], resample(1, 10, np.random.default_rng(0)), 0.95)
    assert (alone["coverage"], alone["low"], alone["high"]) == (0.9, None, None)
