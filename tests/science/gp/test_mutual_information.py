"""Utilities against mutual information by draws of theta ~ N(theta_MAP, S), where their approximations hold.

Outputs are large and S is small: the mean then carries what a measurement tells, and is nearly linear in theta.
"""

import numpy as np
import pytest

from stages.science.gp.marginal import condition, fit
from stages.science.gp.mutual_information import Information, draw_models, path_information, point_information
from tests.science.gp.data import make_data, make_prior

THETA = np.array([0.2, 0.3, 0.1, 0.2, np.log(0.3)])
DRAWS = 3000


@pytest.fixture(scope="module")
def model():
    source = np.random.default_rng(20260701)
    x = source.uniform(-1.5, 1.5, (12, 3))
    y = 20.0 * np.sin(2 * x[:, 0]) * np.cos(x[:, 1]) + 15.0 * x[:, 2]
    root = 0.05 * (np.eye(5) + 0.3 * source.standard_normal((5, 5)))
    return condition(x, y, THETA, make_prior(), covariance=root @ root.T)


@pytest.fixture(scope="module")
def paths(model):
    """Three points, the last the best of 40, and a path of five."""
    points = np.random.default_rng(20260702).uniform(-1.5, 1.5, (40, 3))
    time = np.linspace(0, 1, 5)
    path = 0.8 * np.stack([np.sin(2 * time), np.cos(2 * time), time], axis=1)
    return [*points[np.argsort(model.utility(points, "y_y_theta"))[[5, 20, 39]], None], path]


@pytest.fixture(scope="module")
def estimates(model, paths):
    """The textbook's estimates of measurements along these, with standard errors."""
    sources = [np.random.default_rng(20260703)] * 3 + [np.random.default_rng(20260704)]
    return [estimate_information(model, *each) for each in zip(paths, sources, strict=True)]


def hold(model, covariance):
    """Return the model with a given covariance of its hyperparameters."""
    return condition(model.inputs, model.posterior.outputs, THETA, make_prior(), covariance=covariance)


def kernel(thetas, left, right):
    """Return the covariance at each of (S, 5) draws."""
    scaled = (left[:, None] - right[None]) / np.exp(thetas[:, None, None, :3])
    return np.exp(2 * thetas[:, 3, None, None] - 0.5 * (scaled**2).sum(axis=3))


def predict_outputs(thetas, x, y, path):
    """Return means and covariances of the noisy outputs along a path at each draw, by the textbook."""
    noise = np.exp(2 * thetas[:, 4, None, None])
    weights = np.linalg.solve(kernel(thetas, x, x) + noise * np.eye(len(x)), kernel(thetas, x, path))
    covariances = kernel(thetas, path, path) - kernel(thetas, path, x) @ weights + noise * np.eye(len(path))
    return np.moveaxis(weights, 2, 1) @ y, covariances


def estimate_information(model, path, generator):
    """Return I(theta; y along the path) by nested Monte Carlo (nats) and its standard error."""
    thetas = generator.multivariate_normal(model.theta, model.laplace.covariance, DRAWS)
    means, covariances = predict_outputs(thetas, model.inputs, model.posterior.outputs, path)
    roots = np.linalg.cholesky(covariances)
    outputs = means + np.einsum("kij,kj->ki", roots, generator.standard_normal(means.shape))
    inverses = np.linalg.inv(roots)
    centres = np.einsum("kij,kj->ki", inverses, means)
    halves = np.log(np.diagonal(inverses, axis1=1, axis2=2)).sum(axis=1)
    densities = np.tile(halves, (DRAWS, 1))
    for row in range(len(path)):
        densities -= 0.5 * (outputs @ inverses[:, row].T - centres[:, row]) ** 2
    own, largest = np.diag(densities).copy(), densities.max(axis=1)
    densities -= largest[:, None]
    told = own - largest - np.log(np.exp(densities, out=densities).mean(axis=1))
    return told.mean(), told.std() / np.sqrt(DRAWS)


def test_y_y_theta_is_mutual_information_of_a_measurement(model, paths, estimates):
    for point, (expected, error) in zip(paths[:3], estimates, strict=False):
        assert model.utility(point, "y_y_theta") == pytest.approx(expected, abs=3 * error + 0.03 * expected)
        assert error < 0.1 * expected


def test_y_y_is_that_information_plus_what_a_third_of_v_adds(model, paths, estimates):
    best, (expected, error) = paths[2], estimates[2]
    variance = model.predict(best)[1][0]
    noisy = variance + model.noise_variance
    with_third = 0.5 * np.log(np.exp(2 * expected) + variance / 3 / noisy)
    assert model.utility(best, "y_y")[0] == pytest.approx(with_third, abs=3 * error + 0.03 * with_third)


def test_log_det_is_mutual_information_of_correlated_measurements(model, paths, estimates):
    expected, error = estimates[3]
    assert model.joint_information(paths[3]) == pytest.approx(expected, abs=3 * error + 0.03 * expected)
    assert model.utility(paths[3], "y_y_theta").sum() > expected + 5 * error


def test_estimates_by_draws_agree_with_the_textbook_estimate(model, paths, estimates, generator):
    with pytest.raises(ValueError, match="draws: expected at least 2, got 1"):
        draw_models(model, 1, generator)
    models = draw_models(model, 600, generator)
    densities = point_information(models, np.vstack(paths[:3]))
    assert densities.shape == (600, 3)
    along = path_information(models, paths[3][None], generator.standard_normal((4, 600, 5)))
    for own, (expected, error) in zip(np.hstack([densities, along]).T, estimates, strict=True):
        found = Information.of(own)
        assert found.value == pytest.approx(expected, abs=4 * np.hypot(error, found.standard_error))
    assert found.standard_error < 0.1 * found.value
    point, models = generator.uniform(-1.5, 1.5, (1, 3)), draw_models(model, 500, generator)
    alone = Information.of(point_information(models, point)[:, 0])
    path = Information.of(path_information(models, point[None], generator.standard_normal((40, 500, 1)))[:, 0])
    assert path.value == pytest.approx(alone.value, abs=3 * path.standard_error)


def test_log_det_of_one_point_is_its_information_through_the_mean(model, generator):
    for point in generator.uniform(-1.5, 1.5, (5, 1, 3)):
        dm = model.sensitivities(point)[0][0]
        variance = model.predict(point)[1][0] + model.noise_variance
        told = 0.5 * np.log1p(dm @ model.laplace.covariance @ dm / variance)
        assert model.joint_information(point) == pytest.approx(told, rel=1e-9)
        once, twice = told, model.joint_information(np.vstack([point, point]))
        assert once < twice < 2 * once


def test_a_singular_covariance_tells_what_its_directions_tell(model, paths, generator):
    path = paths[3]
    known = hold(model, np.zeros((5, 5)))
    assert known.joint_information(path) == 0.0
    assert (known.utility(path, "y_y_theta") == 0.0).all()
    np.testing.assert_allclose(point_information(draw_models(known, 50, generator), path), 0.0, atol=1e-12)
    line = np.outer(np.arange(5.0), np.arange(5.0)) * 1e-3
    rank_one, nearly = (hold(model, line + each * np.eye(5)).joint_information(path) for each in (0.0, 1e-12))
    assert rank_one == pytest.approx(nearly, rel=1e-6)
    assert rank_one > 0.01


def test_an_indefinite_covariance_scores_nothing(model):
    held = hold(model, np.diag([0.1, 0.1, -0.1, 0.1, 0.1]))
    for evaluate in (held.joint_information, lambda points: held.utility(points, "y_y")):
        with pytest.raises(ValueError, match=r"expected positive semi-definite, got smallest eigenvalue -0\.1"):
            evaluate(np.zeros((2, 3)))


def test_information_does_not_depend_on_the_size_of_blocks(model, generator, monkeypatch):
    models = draw_models(model, 40, generator)
    points = generator.uniform(-1.5, 1.5, (30, 3))
    whole = point_information(models, points)
    monkeypatch.setattr("stages.science.gp.mutual_information.LARGEST_BLOCK", 40 * 40 * 7)
    np.testing.assert_array_equal(point_information(models, points), whole)


def integrate_information(scales, weights):
    """Return I(y; l) of y ~ N(0, s^2) with s by chance one of (K,) scales, by a fine grid over y."""
    y, step = np.linspace(-60.0, 60.0, 240_001, retstep=True)
    density = sum(w * np.exp(-0.5 * (y / s) ** 2) / s for s, w in zip(scales, weights, strict=True)) / np.sqrt(
        2 * np.pi
    )
    marginal = -np.sum(density * np.log(np.maximum(density, 1e-300))) * step
    return marginal - weights @ (0.5 * np.log(2 * np.pi * np.e) + np.log(scales))


@pytest.mark.parametrize("sd", [0.05, 0.2, 0.35])
def test_what_the_spread_of_a_measurement_tells_is_an_integral(sd):
    """Far from data, without noise, l = 2 log sf; where 400 data fix f, l = 2 log sn: nothing else tells."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(40)
    for known, log_sf, log_sn, moved in ((1, 0.3, -9.0, 3), (400, 0.2, np.log(0.3), 4)):
        covariance = np.zeros((5, 5))
        covariance[moved, moved] = sd**2
        theta = np.array([0.2, 0.3, 0.1, log_sf, log_sn])
        model = condition(np.zeros((known, 3)), np.zeros(known), theta, make_prior(), covariance=covariance)
        point = np.full((1, 3), 50.0 if known == 1 else 0.0)
        expected = integrate_information(np.exp(sd * nodes), weights / weights.sum())
        told = model.utility(point, "hyperparameter_information")[0]
        assert 0.99 * expected < told < (1.01 + 2 * sd**2) * expected
        assert known == 1 or model.utility(point, "y_y_theta")[0] < 0.01 * expected


def test_what_mean_and_spread_tell_together_is_nearer_to_the_estimate_than_y_y_and_y_y_theta(generator):
    """Models of few data with their own Laplace approximations, at many points."""
    off, ratios = {"y_y": [], "y_y_theta": [], "hyperparameter_information": []}, []
    for count in (10, 40):
        x, y = make_data(generator, count)
        model = fit(x, y, make_prior(variance=0.2), generator=generator, starts=2)
        points = generator.uniform(-1.5, 1.5, (60, 3))
        expected = point_information(draw_models(model, 300, generator), points).mean(axis=0)
        for name, its in off.items():
            scores = model.utility(points, name)
            its.extend(np.abs(np.log(scores / expected)))
        ratios.append(scores.sum() / expected.sum())
    errors = {name: np.mean(its) for name, its in off.items()}
    assert errors["hyperparameter_information"] < 0.5 * min(errors["y_y"], errors["y_y_theta"]), errors
    assert all(0.95 < ratio < 1.3 for ratio in ratios), ratios


def test_hyperparameter_information_holds_what_the_mean_tells(model, paths, estimates):
    for point, (expected, error) in zip(paths[:3], estimates, strict=False):
        told = model.utility(point, "hyperparameter_information")[0]
        assert told == pytest.approx(expected, abs=3 * error + 0.03 * expected)
        assert told > model.joint_information(point)
