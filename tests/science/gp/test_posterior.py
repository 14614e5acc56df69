"""The posterior of the hyperparameters, and its Laplace approximation."""

import numpy as np
import pytest
from scipy.stats import norm
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from stages.science.gp.hyperprior import Hyperprior
from stages.science.gp.laplace import approximate
from stages.science.gp.marginal import condition, fit
from stages.science.gp.posterior import LogPosterior
from stages.science.gp.sparse_marginal import condition_sparse
from tests.science.gp.data import Textbook, differences, make_data, make_prior


@pytest.mark.parametrize("mean", ["zero", "constant"])
def test_value_is_a_sum_of_densities_and_derivatives_are_its_slopes(mean, generator):
    posterior = LogPosterior(*make_data(generator, 12), make_prior(mean=mean), mean)
    for theta in posterior.prior.draw(4, generator):
        likelihood = Textbook(posterior.inputs, posterior.outputs, theta).log_likelihood
        prior = norm(posterior.prior.mean, np.sqrt(posterior.prior.variance)).logpdf(theta).sum()
        assert posterior.log_likelihood(theta) == pytest.approx(likelihood, abs=1e-9)
        assert posterior.value(theta) == pytest.approx(likelihood + prior, abs=1e-9)
        value, gradient, hessian = posterior.derivatives(theta)
        assert value == pytest.approx(likelihood + prior, abs=1e-9)
        np.testing.assert_allclose(gradient, differences(posterior.value, theta, 1e-5), rtol=1e-7, atol=1e-6)
        ascent = posterior.ascent(theta)
        assert ascent[0] == pytest.approx(value, abs=1e-11)
        np.testing.assert_allclose(ascent[1], gradient, rtol=1e-10, atol=1e-10)
        slope = differences(lambda at: posterior.derivatives(at)[1], theta, 1e-5)
        np.testing.assert_allclose(hessian, slope, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(hessian, hessian.T, rtol=1e-12, atol=1e-12)


def test_log_marginal_likelihood_and_gradient_are_those_of_scikit_learn(generator):
    x, y = make_data(generator, 25)
    posterior = LogPosterior(x, y, make_prior())
    for theta in posterior.prior.draw(4, generator):
        kernel = ConstantKernel(np.exp(2 * theta[3])) * RBF(np.exp(theta[:3])) + WhiteKernel(np.exp(2 * theta[4]))
        theirs = GaussianProcessRegressor(kernel, optimizer=None, alpha=0.0).fit(x, y)
        value, slope = theirs.log_marginal_likelihood(kernel.theta, eval_gradient=True)
        ours = posterior.likelihood_derivatives(theta)
        assert ours[0] == pytest.approx(value, rel=1e-10)
        np.testing.assert_allclose(ours[1], np.append(slope[1:4], [2 * slope[0], 2 * slope[4]]), rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize(
    ("inputs", "outputs", "told"),
    [
        (np.zeros(3), np.zeros(3), r"expected inputs \(N, D\) and outputs \(N,\), got shapes \(3,\) and \(3,\)"),
        (np.zeros((3, 2)), np.zeros(2), r"got shapes \(3, 2\) and \(2,\)"),
        (np.zeros((0, 3)), np.zeros(0), r"got shapes \(0, 3\) and \(0,\)"),
        (np.array([[0.0, 0, 0], [0, np.nan, 0]]), np.zeros(2), r"expected finite inputs.* in row 1"),
        (np.zeros((2, 3)), np.array([0.0, np.inf]), "expected finite outputs.* inf in row 1"),
        (np.full((2, 3), 1e60), np.zeros(2), r"expected inputs within 1e\+50.* in row 0; standardise them"),
        (np.zeros((2, 3)), np.array([0.0, -1e308]), r"expected outputs within 1e\+50.* in row 1; standardise them"),
    ],
)
def test_data_that_make_no_sense_are_refused(inputs, outputs, told):
    with pytest.raises(ValueError, match=told):
        LogPosterior(inputs, outputs, make_prior())
    few = "hyperprior: expected 6 entries for 3 inputs and a constant mean, got 5"
    for mean, wrong in (("constant", few), ("linear", "mean: expected one of zero, constant, got 'linear'")):
        with pytest.raises(ValueError, match=wrong):
            LogPosterior(np.zeros((2, 3)), np.zeros(2), make_prior(), mean)


@pytest.mark.parametrize(
    ("mean", "variance", "told"),
    [
        ([0.0, 0.0], [1.0], r"mean and variance of one length, got \(2,\), \(1,\)"),
        ([[0.0]], [[1.0]], "mean and variance of one length"),
        *(([each], [1.0], r"finite means .* means within 1e\+50") for each in (np.nan, np.inf, -np.inf, 1e51)),
        *(
            ([0.0], [each], r"finite .* positive variances, .* variances between 1e-100 and 1e\+100")
            for each in (0.0, -1.0, np.inf, np.nan, 5e-324, 1e-300, 1e300)
        ),
    ],
)
def test_a_hyperprior_that_makes_no_sense_is_refused(mean, variance, told):
    with pytest.raises(ValueError, match=f"hyperprior: expected {told}") as caught:
        Hyperprior(np.array(mean), np.array(variance))
    assert str(caught.value).isprintable()


def test_draws_follow_the_hyperprior(generator):
    prior = Hyperprior(np.array([1.0, -2.0]), np.array([0.25, 4.0]))
    draws = prior.draw(20_000, generator)
    np.testing.assert_allclose(draws.mean(axis=0), prior.mean, atol=0.06)
    np.testing.assert_allclose(draws.var(axis=0), prior.variance, rtol=0.06)


def turn(generator, values):
    """Return axes at random, in columns, and minus a matrix of these eigenvalues along them."""
    axes = np.linalg.qr(generator.standard_normal((len(values), len(values))))[0]
    return axes, -(axes * values) @ axes.T


def test_a_positive_definite_hessian_is_left_alone(generator):
    values = np.array([1e-6, 0.5, 2.0, 30.0, 1e5])
    axes, hessian = turn(generator, values)
    found = approximate(hessian, make_prior())
    assert found.repair == ""
    np.testing.assert_allclose(found.covariance @ -hessian, np.eye(5), atol=1e-5)
    assert (found.covariance == found.covariance.T).all()
    np.testing.assert_allclose(np.square(axes.T @ found.root).sum(axis=1), 1 / values, rtol=1e-3)
    model = fit(*make_data(generator, 20), make_prior(), generator=generator)
    hessian = model.posterior.derivatives(model.theta)[2]
    np.testing.assert_allclose(model.laplace.covariance, np.linalg.inv(-hessian), rtol=1e-9)
    assert model.repair == ""


@pytest.mark.parametrize("values", [(-3.0, 5.0, 7.0, 9.0), (0.0, 5.0, 7.0, 9.0), (-4.0, -3.0)])
def test_directions_without_a_peak_get_the_hyperpriors_precision(values, generator):
    axes, hessian = turn(generator, values)
    prior = Hyperprior(np.zeros(len(values)), np.array([0.1, 0.5, 2.0, 4.0])[: len(values)])
    found, flat = approximate(hessian, prior), sum(each <= 0 for each in values)
    assert found.repair == f"indefinite Hessian: hyperprior's precision along {flat} of {len(values)} directions"
    for column, value in zip(axes.T, values, strict=True):
        expected = value if value > 0 else column @ np.diag(1 / prior.variance) @ column
        assert column @ found.covariance @ column == pytest.approx(1 / expected, rel=1e-9)
    assert np.linalg.eigvalsh(found.covariance)[0] > 0


@pytest.mark.parametrize("sparse", [False, True], ids=["exact", "sparse"])
def test_an_indefinite_model_scores_and_says_so(sparse, generator):
    x, y = make_data(generator, 8)
    theta, prior = np.array([4.0, 4.0, 4.0, 3.0, -3.0]), make_prior(variance=100.0)
    assert np.linalg.eigvalsh(-LogPosterior(x, y, prior).derivatives(theta)[2])[0] < 0
    model = condition_sparse(x, y, x, theta, prior) if sparse else condition(x, y, theta, prior)
    assert model.repair.startswith("indefinite Hessian: hyperprior's precision along ")
    assert np.linalg.eigvalsh(model.laplace.covariance)[0] > 0
    points = generator.uniform(-2, 2, (20, 3))
    marginal = model.predict_marginal(points)[1]
    assert (marginal > 4 / 3 * model.predict(points)[1]).all()
    assert (model.utility(points, "y_y_theta") > 0).all()
    assert np.isfinite(model.utility(x, "y_y")).all()


def test_rounding_of_a_given_covariance_is_no_indefiniteness(generator):
    x, y = make_data(generator, 8)
    vector = generator.standard_normal(5)
    given = np.outer(vector, vector)
    given[0, 1] += 1e-17
    model = condition(x, y, np.array([0.0, 0, 0, 0, -2]), make_prior(), covariance=given)
    assert np.isfinite(model.utility(x, "y_y_theta")).all()
