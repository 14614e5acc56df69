"""What a model expects of itself, against scikit-learn, and against models that never had a trial."""

import numpy as np
import pytest
from scipy.stats import norm
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel

from stages.science.gp.expected_error import expect_error, leave_trials_out, scale_intervals
from stages.science.gp.marginal import condition
from tests.science.gp.data import make_data, make_prior


@pytest.fixture
def model(generator):
    prior = make_prior()
    return condition(*make_data(generator, 12), prior.draw(1, generator)[0], prior)


def regress(model, kept):
    """Return scikit-learn's process of some of a model's points, with its hyperparameters."""
    told = model.hyperparameters
    kernel = ConstantKernel(told.signal_variance) * RBF(told.lengths)
    process = GaussianProcessRegressor(kernel, optimizer=None, alpha=told.noise_variance)
    return process.fit(model.inputs[kept], model.posterior.outputs[kept])


def expected(model, kept, inputs):
    sd = regress(model, kept).predict(inputs, return_std=True)[1]
    return np.sqrt(np.mean(sd**2) + model.noise_variance)


def test_expects_the_predictive_variance_of_a_measurement(model, generator):
    inputs = generator.uniform(-1.5, 1.5, (40, 3))
    assert expect_error(model, inputs) == pytest.approx(expected(model, slice(None), inputs), rel=1e-8)


def test_trials_are_left_out_with_all_their_points_and_no_others(model, generator):
    trials = np.array([-1, -1, 0, 0, 0, 1, 1, 1, 2, 2, 2, 2])
    executed = [make_data(generator, 20) for _ in range(3)]
    found = leave_trials_out(model, trials, executed)
    for k, (inputs, outputs) in enumerate(executed):
        measured = np.sqrt(np.mean((regress(model, trials != k).predict(inputs) - outputs) ** 2))
        assert found[k] == pytest.approx([expected(model, trials != k, inputs), measured], rel=1e-8)


@pytest.mark.parametrize("level", [0.5, 0.95])
def test_scaled_intervals_hold_their_share_of_the_trials_that_were_left_out(generator, level):
    prior = make_prior()
    theta = prior.draw(1, generator)[0]
    sure = condition(*make_data(generator, 12), theta, prior, covariance=np.zeros((theta.size, theta.size)))
    trials = np.repeat([-1, 0, 1, 2], 3)
    executed = [make_data(generator, 40) for _ in range(3)]
    factor = scale_intervals(sure, trials, executed, level)
    within = []
    for k, (inputs, outputs) in enumerate(executed):
        mean, sd = regress(sure, trials != k).predict(inputs, return_std=True)
        variance = 4 / 3 * sd**2  # Garnett, Osborne and Hennig (2014) where the hyperparameters are known
        half = factor * norm.ppf(0.5 + level / 2) * np.sqrt(variance + sure.noise_variance)
        within.append(np.abs(outputs - mean) <= half * (1 + 1e-9))
    assert np.mean(within) == pytest.approx(level, abs=1 / 120)
    unsure = condition(sure.inputs, sure.posterior.outputs, theta, prior, covariance=0.3 * np.eye(theta.size))
    assert scale_intervals(unsure, trials, executed, level) < factor


def test_every_point_has_a_trial(model, generator):
    with pytest.raises(ValueError, match="trials: expected 12, one for each point, got 3"):
        leave_trials_out(model, np.zeros(3, dtype=int), [make_data(generator, 20)])
