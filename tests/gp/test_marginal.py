import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from stages.gp import condition, fit
from tests.gp.data import differences, make_data, make_prior

MEANS = ("zero", "constant")


@pytest.fixture(params=MEANS)
def model(request, generator):
    prior = make_prior(mean=request.param)
    return condition(*make_data(generator, 15), prior.draw(1, generator)[0], prior, request.param)


def rebuild(model, theta):
    return condition(model.inputs, model.posterior.outputs, theta, model.posterior.prior, model.posterior.mean)


def places(model, generator):
    """Return points among the data, exactly on them, far from them, and nearly on one."""
    return {
        "among": generator.uniform(-1.5, 1.5, (20, 3)),
        "on": model.inputs[:6].copy(),
        "far": np.array([[40.0, -30.0, 60.0], [1e3, 0.0, 0.0], [6.0, 6.0, 6.0]]),
        "near": model.inputs[:3] + 1e-7,
    }


@pytest.mark.parametrize("place", ["among", "on", "far", "near"])
def test_sensitivities_are_slopes_of_mean_and_variance(model, place, generator):
    points = places(model, generator)[place]
    dm, dv = model.sensitivities(points)
    slopes = differences(lambda at: rebuild(model, at).predict(points), model.theta, 1e-5)
    np.testing.assert_allclose(dm, slopes[:, 0].T, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(dv, slopes[:, 1].T, rtol=1e-6, atol=1e-8)


def test_sensitivities_hold_with_inputs_of_many_lengths(generator):
    x, y = make_data(generator, 20)
    far_apart = x * np.array([1e6, 1.0, 1e-3])
    prior = make_prior()
    theta = np.array([np.log(2.0), 0.0, np.log(1e-3), 0.0, -2.0])
    model = condition(far_apart, y, theta, prior)
    points = np.vstack([far_apart[:5], far_apart[5:10] + np.array([0.5, 0.3, 3e-4])])
    dm, dv = model.sensitivities(points)
    slopes = differences(lambda at: rebuild(model, at).predict(points), theta, 1e-5)
    np.testing.assert_allclose(dm, slopes[:, 0].T, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(dv, slopes[:, 1].T, rtol=1e-5, atol=1e-6)
    differ = points[:, None] - far_apart[None]
    k = np.exp(-0.5 * ((differ / np.exp(theta[:3])) ** 2).sum(axis=2))
    assert (k.max(axis=1) > 0.5).all()
    covariance = np.exp(-0.5 * (((far_apart[:, None] - far_apart[None]) / np.exp(theta[:3])) ** 2).sum(axis=2))
    noisy = covariance + np.exp(-4.0) * np.eye(20)
    mean, variance = model.predict(points)
    np.testing.assert_allclose(mean, k @ np.linalg.solve(noisy, y), atol=1e-10)
    np.testing.assert_allclose(variance, 1.0 - np.einsum("bn,nb->b", k, np.linalg.solve(noisy, k.T)), atol=1e-10)


def test_predictions_are_those_of_scikit_learn(generator):
    x, y = make_data(generator, 30)
    prior = make_prior()
    points = generator.uniform(-2, 2, (200, 3))
    for theta in prior.draw(4, generator):
        kernel = ConstantKernel(np.exp(2 * theta[3])) * RBF(np.exp(theta[:3]))
        theirs = GaussianProcessRegressor(kernel, optimizer=None, alpha=np.exp(2 * theta[4])).fit(x, y)
        expected, deviation = theirs.predict(points, return_std=True)
        model = condition(x, y, theta, prior)
        mean, variance = model.predict(points)
        np.testing.assert_allclose(mean, expected, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(variance, deviation**2, rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(model.predict_mean(points), mean, rtol=1e-12, atol=1e-12)


def test_a_fit_is_where_scikit_learn_ends_when_the_hyperprior_is_wide(generator):
    x, y = make_data(generator, 40)
    ours = fit(x, y, make_prior(variance=1e6), generator=generator, starts=0, warm_starts=[make_prior().mean])
    kernel = ConstantKernel(1.0) * RBF(np.ones(3)) + WhiteKernel(np.exp(-4.0), (1e-9, 1e9))
    theirs = GaussianProcessRegressor(kernel, n_restarts_optimizer=0, alpha=0.0).fit(x, y)
    assert ours.posterior.log_likelihood(ours.theta) >= theirs.log_marginal_likelihood_value_ - 1e-6
    found = theirs.kernel_.theta
    np.testing.assert_allclose(ours.theta, np.append(found[1:4], [found[0] / 2, found[4] / 2]), atol=2e-3)


def test_marginal_variance_is_the_formula_with_slopes_and_laplace_covariance(model, generator):
    fitted = fit(
        model.inputs,
        model.posterior.outputs,
        model.posterior.prior,
        model.posterior.mean,
        generator=generator,
    )
    points = generator.uniform(-2, 2, (15, 3))
    mean, variance = fitted.predict(points)
    slopes = differences(lambda at: rebuild(fitted, at).predict(points), fitted.theta, 1e-5)
    spread = np.linalg.inv(-differences(lambda at: fitted.posterior.derivatives(at)[1], fitted.theta, 1e-5))
    through_mean = np.einsum("pb,pq,qb->b", slopes[:, 0], spread, slopes[:, 0])
    through_variance = np.einsum("pb,pq,qb->b", slopes[:, 1], spread, slopes[:, 1])
    marginal_mean, marginal = fitted.predict_marginal(points)
    np.testing.assert_allclose(marginal_mean, mean, rtol=1e-12)
    np.testing.assert_allclose(marginal, 4 / 3 * variance + through_mean + through_variance / (3 * variance), rtol=1e-5)


def test_a_given_covariance_takes_the_place_of_the_laplace_approximation(model, generator):
    points = generator.uniform(-2, 2, (15, 3))
    given = np.diag(generator.uniform(0.01, 0.1, model.theta.size))
    held = condition(
        model.inputs, model.posterior.outputs, model.theta, model.posterior.prior, model.posterior.mean, given
    )
    dm, dv = model.sensitivities(points)
    variance = model.predict(points)[1]
    expected = 4 / 3 * variance + dm**2 @ np.diag(given) + dv**2 @ np.diag(given) / (3 * variance)
    np.testing.assert_allclose(held.predict_marginal(points)[1], expected, rtol=1e-10)
    assert held.repair == ""


def test_growing_is_conditioning_on_all_data_with_theta_and_covariance_held(model, generator):
    x, y = make_data(generator, 4)
    points = generator.uniform(-2, 2, (10, 3))
    posterior = model.posterior
    whole = condition(
        np.vstack([model.inputs, x]),
        np.append(posterior.outputs, y),
        model.theta,
        posterior.prior,
        posterior.mean,
        model.laplace.covariance,
    )
    for ours, expected in zip(model.grow(x, y).predict_marginal(points), whole.predict_marginal(points), strict=True):
        np.testing.assert_allclose(ours, expected, rtol=1e-10)


@pytest.mark.parametrize(
    ("points", "told"),
    [
        (np.zeros(3), r"points: expected shape \(B, 3\), got \(3,\)"),
        (np.zeros((4, 2)), r"points: expected shape \(B, 3\), got \(4, 2\)"),
        (np.array([[0.0, 0, 0], [0, np.nan, 0]]), "points: expected finite values.* in row 1"),
        (np.full((1, 3), -np.inf), "points: expected finite values.* in row 0"),
    ],
)
def test_points_that_make_no_sense_are_refused(model, points, told):
    for evaluate in (model.predict, model.predict_mean, model.predict_marginal, model.joint_information):
        with pytest.raises(ValueError, match=told):
            evaluate(points)
    with pytest.raises(ValueError, match=told):
        model.utility(points, "y_y")


def test_no_points_give_nothing(model):
    assert model.predict(np.zeros((0, 3)))[1].shape == (0,)
    assert model.utility(np.zeros((0, 3)), "y_y").shape == (0,)


def test_a_theta_of_another_length_is_refused(generator):
    x, y = make_data(generator, 5)
    with pytest.raises(ValueError, match=r"theta: expected 5 entries, got shape \(6,\)"):
        condition(x, y, np.zeros(6), make_prior())


def test_a_covariance_of_another_shape_is_refused(generator):
    x, y = make_data(generator, 5)
    with pytest.raises(ValueError, match=r"covariance: expected shape \(5, 5\), got \(4, 4\)"):
        condition(x, y, np.zeros(5), make_prior(), covariance=np.eye(4))
