"""What measurements along a path tell of hyperparameters, where there is a closed form."""

import numpy as np
import pytest

from stages.science.gp.marginal import condition
from tests.science.gp.data import make_data, make_prior

THETA = np.array([0.2, 0.3, 0.1, 0.2, np.log(0.3)])


@pytest.fixture
def covariance(generator):
    root = 0.02 * (np.eye(5) + 0.3 * generator.standard_normal((5, 5)))
    covariance = root @ root.T
    covariance[4], covariance[:, 4] = 0.0, 0.0
    covariance[4, 4] = 1e-8
    return covariance


@pytest.fixture
def model(covariance, generator):
    """A model of outputs so large that lengths matter to the mean far more than to the variance."""
    x, y = make_data(generator, 40)
    return condition(x, 20 * y, THETA, make_prior(), covariance=covariance)


def test_log_det_of_one_point_is_its_information_through_the_mean(model, covariance, generator):
    for point in generator.uniform(-1.5, 1.5, (5, 1, 3)):
        dm = model.sensitivities(point)[0][0]
        variance = model.predict(point)[1][0] + model.noise_variance
        assert model.joint_information(point) == pytest.approx(
            0.5 * np.log1p(dm @ covariance @ dm / variance), rel=1e-9
        )


def test_repeating_a_point_tells_less_than_twice_as_much(model):
    point = np.array([[0.5, -0.5, 0.8]])
    once, twice = model.joint_information(point), model.joint_information(np.vstack([point, point]))
    assert once < twice < 2 * once


def test_a_singular_covariance_tells_what_its_directions_tell(model, generator):
    path = generator.uniform(-1, 1, (6, 3))
    data = model.posterior
    known = condition(data.inputs, data.outputs, THETA, data.prior, covariance=np.zeros((5, 5)))
    assert known.joint_information(path) == 0.0
    assert (known.utility(path, "y_y_theta") == 0.0).all()
    line = np.outer(np.arange(5.0), np.arange(5.0)) * 1e-3
    rank_one = condition(data.inputs, data.outputs, THETA, data.prior, covariance=line)
    nearly = condition(data.inputs, data.outputs, THETA, data.prior, covariance=line + 1e-12 * np.eye(5))
    assert rank_one.joint_information(path) == pytest.approx(nearly.joint_information(path), rel=1e-6)
    assert rank_one.joint_information(path) > 0.01


def test_an_indefinite_covariance_scores_nothing(model, generator):
    data = model.posterior
    indefinite = np.diag([0.1, 0.1, -0.1, 0.1, 0.1])
    held = condition(data.inputs, data.outputs, THETA, data.prior, covariance=indefinite)
    told = "covariance: expected positive semi-definite, got smallest eigenvalue -0.1"
    with pytest.raises(ValueError, match=told):
        held.utility(np.zeros((2, 3)), "y_y")
    with pytest.raises(ValueError, match=told):
        held.joint_information(np.zeros((2, 3)))
