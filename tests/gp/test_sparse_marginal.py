import re

import numpy as np
import pytest

from stages.gp import (
    UTILITIES,
    SparseGP,
    SparseMarginalGP,
    SparsePosterior,
    condition,
    condition_sparse,
    fit_sparse,
    predict_weighted,
    trajectory_utility,
)
from tests.gp.data import differences, make_data, make_prior
from tests.gp.test_sparse import Dense

MEANS = ("zero", "constant")


def make_models(generator, mean, count=60, pseudo_count=8):
    """Return data, pseudo-inputs off them, a theta and the model that they make."""
    prior = make_prior(mean=mean)
    x, y = make_data(generator, count)
    pseudo = generator.uniform(-2.0, 2.0, (pseudo_count, 3))
    theta = prior.draw(1, generator)[0]
    return x, y, pseudo, theta, condition_sparse(x, y, pseudo, theta, prior, mean)


def places(x, pseudo, generator):
    """Return points among the data, on them, on pseudo-inputs, and far away."""
    return np.vstack([generator.uniform(-2, 2, (30, 3)), x[:5], pseudo[:5], [[6.0, 6, 6], [40, -30, 60]]])


@pytest.mark.parametrize("mean", MEANS)
def test_pseudo_inputs_on_all_data_make_the_exact_marginal_gp(mean, generator):
    prior = make_prior(mean=mean)
    for theta in prior.draw(5, generator):
        x, y = make_data(generator, 30)
        exact, sparse = condition(x, y, theta, prior, mean), condition_sparse(x, y, x, theta, prior, mean)
        np.testing.assert_allclose(sparse.laplace.covariance, exact.laplace.covariance, rtol=1e-4, atol=1e-7)
        assert sparse.repair == exact.repair
        points = places(x, x, generator)
        for ours, theirs in zip(sparse.sensitivities(points), exact.sensitivities(points), strict=True):
            np.testing.assert_allclose(ours, theirs, atol=1e-6)
        for ours, theirs in zip(sparse.predict_marginal(points), exact.predict_marginal(points), strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-6)
        for name in UTILITIES:
            np.testing.assert_allclose(sparse.utility(points, name), exact.utility(points, name), atol=1e-5)
        bank = points[None]
        expected = trajectory_utility([exact], [bank], "y_y")
        np.testing.assert_allclose(trajectory_utility([sparse], [bank], "y_y"), expected, rtol=1e-5)


@pytest.mark.parametrize("mean", MEANS)
def test_sensitivities_are_slopes_of_the_whole_covariances_predictions(mean, generator):
    for _ in range(4):
        x, y, pseudo, theta, model = make_models(generator, mean)
        points = places(x, pseudo, generator)
        slopes = differences(
            lambda at, z=pseudo, x=x, y=y, points=points: Dense(x, y, z, at).predict(points), theta, 1e-5
        )
        dm, dv = model.sensitivities(points)
        np.testing.assert_allclose(dm, slopes[:, 0].T, rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(dv, slopes[:, 1].T, rtol=1e-5, atol=1e-6)


def test_sensitivities_add_up_over_blocks(generator, monkeypatch):
    monkeypatch.setattr("stages.gp.sparse.BLOCK", 200)
    x, _, pseudo, theta, model = make_models(generator, "constant", count=410)
    points = places(x, pseudo, generator)
    slopes = differences(lambda at: SparseGP(model.posterior, pseudo, at).predict(points), theta, 1e-5)
    for ours, theirs in zip(model.sensitivities(points), (slopes[:, 0].T, slopes[:, 1].T), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-6)


def test_sensitivities_hold_with_inputs_of_many_lengths(generator):
    x, y = make_data(generator, 40)
    stretch = np.array([1e6, 1.0, 1e-3])
    pseudo = (x[:12] + 0.1 * generator.standard_normal((12, 3))) * stretch
    theta = np.array([np.log(2e6), 0.0, np.log(1e-3), 0.0, -2.0])
    model = condition_sparse(x * stretch, y, pseudo, theta, make_prior())
    points = np.vstack([x[:10] * stretch, pseudo])
    slopes = differences(lambda at: Dense(x * stretch, y, pseudo, at).predict(points), theta, 1e-5)
    for ours, theirs in zip(model.sensitivities(points), (slopes[:, 0].T, slopes[:, 1].T), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("mean", MEANS)
def test_laplace_covariance_is_the_inverse_of_the_densitys_curvature(mean, generator):
    prior = make_prior(mean=mean)
    x, y = make_data(generator, 300)
    found = fit_sparse(x, y, 10, prior, mean, generator=generator, starts=1)
    model = condition_sparse(x, y, found.pseudo, found.theta, prior, mean)

    def density(theta):
        return model.posterior.value(found.pseudo, theta)

    def slope(theta):
        return differences(density, theta, 1e-3)

    assert model.repair == ""
    precision = -differences(slope, found.theta, 1e-3)
    np.testing.assert_allclose(model.laplace.covariance @ precision, np.eye(len(precision)), atol=1e-2)
    dense = Dense(x, y, found.pseudo, found.theta).log_likelihood + prior.log_density(found.theta)
    assert model.log_posterior == pytest.approx(dense, rel=1e-8)


@pytest.mark.parametrize("mean", MEANS)
def test_marginal_variance_and_utilities_are_the_formulas(mean, generator):
    x, _, pseudo, _, model = make_models(generator, mean)
    points = places(x, pseudo, generator)
    dm, dv = model.sensitivities(points)
    predicted, v = model.predict(points)
    s, noise = model.laplace.covariance, model.noise_variance
    q = np.einsum("bp,pq,bq->b", dm, s, dm) + np.einsum("bp,pq,bq->b", dv, s, dv) / (3 * v)
    marginal_mean, marginal = model.predict_marginal(points)
    np.testing.assert_allclose(marginal_mean, predicted, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(marginal, 4 / 3 * v + q, rtol=1e-8)
    expected = {
        "y_y": 0.5 * np.log((marginal + noise) / (v + noise)),
        "f_f": 0.5 * np.log(marginal / v),
        "f_y": 0.5 * np.log(marginal / (v + noise)),
        "y_y_theta": 0.5 * np.log1p(q / (v + noise)),
        "variance": v,
    }
    assert set(expected) == set(UTILITIES)
    for name, values in expected.items():
        np.testing.assert_allclose(model.utility(points, name), values, rtol=1e-8)


def test_a_given_covariance_takes_the_place_of_the_laplace_approximation(generator):
    x, _, pseudo, theta, model = make_models(generator, "zero")
    points = places(x, pseudo, generator)
    given = np.diag(generator.uniform(0.01, 0.1, 5))
    held = SparseMarginalGP(model.posterior, pseudo, theta, given)
    dm, dv = model.sensitivities(points)
    v = model.predict(points)[1]
    expected = 4 / 3 * v + dm**2 @ np.diag(given) + dv**2 @ np.diag(given) / (3 * v)
    np.testing.assert_allclose(held.predict_marginal(points)[1], expected, rtol=1e-8)
    assert held.repair == ""


def test_more_data_tell_more_and_leave_less_to_learn(generator):
    x, y = make_data(generator, 2000)
    pseudo, theta = x[:20], np.array([0.3, 0.3, 0.3, 0.2, -2.0])
    points = generator.uniform(-1.5, 1.5, (200, 3))
    few, many = (condition_sparse(x[:n], y[:n], pseudo, theta, make_prior()) for n in (100, 2000))
    assert many.predict(points)[1].mean() < few.predict(points)[1].mean()
    assert np.trace(many.laplace.covariance) < np.trace(few.laplace.covariance)
    assert many.utility(points, "y_y").mean() < few.utility(points, "y_y").mean()


def test_a_flat_direction_is_repaired_as_in_the_exact_model(generator):
    x, y = make_data(generator, 8)
    theta = np.array([4.0, 4.0, 4.0, 3.0, -3.0])
    model = condition_sparse(x, y, x, theta, make_prior(variance=100.0))
    assert model.repair.startswith("indefinite Hessian: hyperprior's precision along ")
    assert np.linalg.eigvalsh(model.laplace.covariance)[0] > 0
    assert np.isfinite(model.utility(x, "y_y")).all()


def test_the_memory_bound_does_not_change_utilities(generator):
    x, _, pseudo, _, model = make_models(generator, "zero")
    points = places(x, pseudo, generator)
    expected = model.utility(points, "y_y")
    for memory_mb in (1e-6, 0.01, 1000.0):
        np.testing.assert_allclose(model.utility(points, "y_y", memory_mb), expected, rtol=1e-10)


def test_working_memory_does_not_leak_into_a_model(generator):
    x, _, pseudo, theta, model = make_models(generator, "zero")
    points = places(x, pseudo, generator)
    before = model.utility(points, "y_y")
    model.posterior.derivatives(pseudo + 0.3, theta - 0.2)
    np.testing.assert_array_equal(model.utility(points, "y_y"), before)
    late = SparseMarginalGP(model.posterior, pseudo, theta)
    late.posterior.derivatives(pseudo + 0.3, theta - 0.2)
    np.testing.assert_array_equal(late.utility(points, "y_y"), before)


@pytest.mark.parametrize("mean", MEANS)
def test_the_mean_needs_pseudo_inputs_weights_and_theta_alone(mean, generator):
    x, y, pseudo, theta, model = make_models(generator, mean)
    sparse, points = model.sparse, places(x, pseudo, generator)
    found = predict_weighted(pseudo, sparse.weights, theta, points)
    np.testing.assert_allclose(found, Dense(x, y, pseudo, theta).predict(points)[0], atol=1e-8)
    np.testing.assert_array_equal(found, model.predict_mean(points))


def test_log_det_is_refused_in_words(generator):
    model = make_models(generator, "zero")[-1]
    told = "utility: log_det takes exact models, got a SparseMarginalGP, which scores points one by one; use one of y_y"
    with pytest.raises(ValueError, match=re.escape(told)):
        trajectory_utility([model], [np.zeros((2, 5, 3))], "log_det")
    with pytest.raises(ValueError, match=r"utility: expected one of y_y, .*, got 'entropy'"):
        model.utility(np.zeros((2, 3)), "entropy")


def test_what_makes_no_sense_is_refused(generator):
    x, y = make_data(generator, 10)
    theta = np.array([0.0, 0, 0, 0, -2])
    with pytest.raises(ValueError, match="expected a hyperprior"):
        SparseMarginalGP(SparsePosterior(x, y), x[:3], theta)
    with pytest.raises(ValueError, match=r"covariance: expected shape \(5, 5\), got \(4, 4\)"):
        SparseMarginalGP(SparsePosterior(x, y, make_prior()), x[:3], theta, np.eye(4))
    model = condition_sparse(x, y, x[:3], theta, make_prior())
    with pytest.raises(ValueError, match=r"points: expected shape \(B, 3\), got \(4, 2\)"):
        model.utility(np.zeros((4, 2)), "y_y")
