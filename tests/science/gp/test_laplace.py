import numpy as np
import pytest

from stages.science.gp.hyperprior import Hyperprior
from stages.science.gp.laplace import approximate
from stages.science.gp.marginal import condition, fit
from stages.science.gp.posterior import LogPosterior
from stages.science.gp.sparse_marginal import condition_sparse
from tests.science.gp.data import make_data, make_prior


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
