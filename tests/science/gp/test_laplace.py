import numpy as np
import pytest

from stages.science.gp.hyperprior import Hyperprior
from stages.science.gp.laplace import approximate
from stages.science.gp.marginal import condition, fit
from stages.science.gp.posterior import LogPosterior
from stages.science.gp.sparse_marginal import condition_sparse
from tests.science.gp.data import make_data, make_prior


def rotation(generator, size):
    return np.linalg.qr(generator.standard_normal((size, size)))[0]


def test_a_positive_definite_hessian_is_left_alone(generator):
    axes = rotation(generator, 5)
    values = np.array([1e-6, 0.5, 2.0, 30.0, 1e5])
    hessian = -(axes * values) @ axes.T
    found = approximate(hessian, make_prior())
    assert found.repair == ""
    assert found.min_eigenvalue == pytest.approx(1e-6, rel=1e-3)
    np.testing.assert_allclose(found.covariance @ -hessian, np.eye(5), atol=1e-5)
    assert (found.covariance == found.covariance.T).all()
    np.testing.assert_allclose(found.spread(axes.T), 1 / values, rtol=1e-3)
    moderate = -(axes * [0.1, 0.5, 2.0, 30.0, 1e3]) @ axes.T
    np.testing.assert_allclose(approximate(moderate, make_prior()).covariance, np.linalg.inv(-moderate), rtol=1e-9)


def test_a_fit_carries_the_inverse_of_minus_its_hessian(generator):
    model = fit(*make_data(generator, 20), make_prior(), generator=generator)
    hessian = model.posterior.derivatives(model.theta)[2]
    np.testing.assert_allclose(model.laplace.covariance, np.linalg.inv(-hessian), rtol=1e-9)
    assert model.repair == ""
    assert model.laplace.min_eigenvalue == pytest.approx(np.linalg.eigvalsh(-hessian)[0], rel=1e-9)


@pytest.mark.parametrize("bad", [-3.0, 0.0])
def test_directions_without_a_peak_get_the_hyperpriors_precision(bad, generator):
    axes = rotation(generator, 4)
    prior = Hyperprior(np.zeros(4), np.array([0.1, 0.5, 2.0, 4.0]))
    found = approximate(-(axes * [bad, 5.0, 7.0, 9.0]) @ axes.T, prior)
    assert found.repair == "indefinite Hessian: hyperprior's precision along 1 of 4 directions"
    assert found.min_eigenvalue == pytest.approx(bad, abs=1e-12)
    expected = axes[:, 0] @ np.diag(1 / prior.variance) @ axes[:, 0]
    assert axes[:, 0] @ found.covariance @ axes[:, 0] == pytest.approx(1 / expected, rel=1e-9)
    for column, value in zip(axes[:, 1:].T, [5.0, 7.0, 9.0], strict=True):
        assert column @ found.covariance @ column == pytest.approx(1 / value, rel=1e-9)
    assert np.linalg.eigvalsh(found.covariance)[0] > 0


def test_all_directions_can_be_repaired():
    prior = Hyperprior(np.zeros(2), np.array([0.1, 0.5]))
    found = approximate(np.diag([4.0, 3.0]), prior)
    assert found.repair == "indefinite Hessian: hyperprior's precision along 2 of 2 directions"
    np.testing.assert_allclose(found.covariance, np.diag(prior.variance), rtol=1e-12)


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
