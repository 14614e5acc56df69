"""Predictions of many points at once against the formulas of a textbook, point by point."""

import numpy as np
import pytest

from stages.gp import condition
from stages.gp.distance import keeps_digits
from tests.gp.data import differences, make_data, make_prior


def answer(model, points):
    """Return mean and variance by solving with the whole covariance."""
    theta = model.theta

    def kernel(left, right):
        scaled = (left[:, None] - right[None]) / np.exp(theta[:3])
        return np.exp(2 * theta[3] - 0.5 * (scaled**2).sum(axis=2))

    noisy = kernel(model.inputs, model.inputs) + np.exp(2 * theta[4]) * np.eye(len(model.inputs))
    cross = kernel(points, model.inputs)
    weights = np.linalg.solve(noisy, cross.T)
    return weights.T @ model.posterior.outputs, np.exp(2 * theta[3]) - np.einsum("bn,nb->b", cross, weights)


@pytest.mark.parametrize("log_length", [0.0, -7.0], ids=["expanded", "direct"])
@pytest.mark.parametrize("count", [1, 5, 17, 63, 130])
@pytest.mark.parametrize("constant", [None, 0, 2])
def test_any_size_and_constant_column_agree_with_the_textbook(log_length, count, constant, generator):
    x, y = make_data(generator, count)
    theta = np.array([log_length, log_length, log_length, 0.3, -2.0])
    x *= np.exp(0.3 * log_length) if log_length else 1.0
    if constant is not None:
        x[:, constant] = 0.7
    model = condition(x, y, theta, make_prior())
    points = np.vstack([x[:3], x[: min(count, 40)] + 0.4 * np.exp(log_length), generator.uniform(-1.5, 1.5, (9, 3))])
    for found, expected in zip(model.predict(points), answer(model, points), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-10)
    dm, dv = model.sensitivities(points)
    slopes = differences(lambda at: answer(condition(x, y, at, make_prior()), points), theta, 1e-5)
    np.testing.assert_allclose(dm, slopes[:, 0].T, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(dv, slopes[:, 1].T, rtol=1e-5, atol=1e-7)


def test_both_ways_to_measure_distance_are_met_above(generator):
    x = make_data(generator, 17)[0]
    assert keeps_digits(x, np.exp(0.6), np.exp(-4.0))
    assert not keeps_digits(x * np.exp(0.7 * 7.0), np.exp(0.6), np.exp(-4.0))
    assert not keeps_digits(x, 1.0, 1e-12)


def test_a_longer_length_never_raises_the_variance(generator):
    for theta in make_prior(variance=2.0).draw(5, generator):
        model = condition(*make_data(generator, 25), theta, make_prior())
        assert (model.sensitivities(generator.uniform(-3, 3, (300, 3)))[1][:, :3] <= 0).all()


@pytest.mark.parametrize("log_noise", [-9.0, -14.0, -20.0])
def test_at_noiseless_data_utilities_approach_their_limit(log_noise, generator):
    """There V = sn^2 and nothing of it depends on the lengths, so that y/y is 1/2 log((4/3 + 1) / 2) at most."""
    x, y = make_data(generator, 10)
    covariance = 0.1 * np.eye(5)
    model = condition(x, y, np.array([-0.5, -0.5, -0.5, 0.3, log_noise]), make_prior(), covariance=covariance)
    marginal, plain = model.predict_marginal(x)[1], model.predict(x)[1]
    assert (plain > 0).all()
    assert (plain <= 1.01 * np.exp(2 * log_noise) + 1e-14).all()
    assert (marginal <= 4 * plain + 1e-12).all()
    assert np.isfinite([model.utility(x, name) for name in ("y_y", "f_f", "f_y", "y_y_theta")]).all()
    assert model.utility(x, "y_y").max() <= 0.5 * np.log(4)
