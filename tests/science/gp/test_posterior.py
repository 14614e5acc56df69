import numpy as np
import pytest
from scipy.stats import norm
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from stages.science.gp.hyperprior import Hyperprior
from stages.science.gp.posterior import LogPosterior
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
    for mean, wrong in (("constant", "hyperprior: expected 6 entries"), ("linear", "mean: expected one of zero, ")):
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
