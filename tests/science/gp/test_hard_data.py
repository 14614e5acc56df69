"""Data that tempt a Gaussian process into NaN: each gives a right answer or an error that says what is wrong."""

import mpmath
import numpy as np
import pytest

from stages.science.gp.factor import RELATIVE_JITTERS, FactorisationError, factorise
from stages.science.gp.marginal import condition, fit
from stages.science.gp.posterior import LogPosterior
from stages.science.gp.sparse import SparsePosterior
from stages.science.gp.sparse_model import SparseGP
from tests.science.gp.data import assert_sound, make_data, make_prior

THETA = np.array([0.1, 0.2, 0.0, 0.1, -2.0])


def test_a_single_point_has_the_textbook_answer(generator):
    x, y = np.array([[0.5, -0.5, 1.0]]), np.array([0.7])
    signal, noise = np.exp(0.2), np.exp(-4.0)
    exact, sparse = condition(x, y, THETA, make_prior()), SparseGP(SparsePosterior(x, y), x, THETA)
    for model, of_mean, of_variance in ((exact, 1e-12, 1e-9), (sparse, 1e-8, 1e-6)):
        mean, variance = model.predict(x)
        assert mean[0] == pytest.approx(0.7 * signal / (signal + noise), rel=of_mean)
        assert variance[0] == pytest.approx(signal * noise / (signal + noise), rel=of_variance)
    assert_sound(fit(x, y, make_prior(), generator=generator), np.vstack([x, x + 1, x + 100]))


def test_far_from_the_data_the_hyperprior_of_f_is_left(generator):
    model = condition(*make_data(generator, 10), np.append(THETA, 0.4), make_prior(mean="constant"), "constant")
    far = np.array([[1e3, 0, 0], [1e20, 0, 0], [1e50, -1e50, 1e50]])
    np.testing.assert_allclose(model.predict(far), [[0.4] * 3, [np.exp(0.2)] * 3], rtol=1e-12)
    slopes = [[[0, 0, 0, 0, 0, 1.0]] * 3, [[0, 0, 0, 2 * np.exp(0.2), 0, 0]] * 3]
    np.testing.assert_allclose(model.sensitivities(far), slopes, rtol=1e-12, atol=1e-12)


def test_duplicates_without_noise_are_parted_by_jitter_that_is_recorded(generator):
    x, y = make_data(generator, 10)
    x[7], y[7] = x[2], y[2]
    theta = np.array([0.1, 0.2, 0.0, 0.0, -30.0])
    model = condition(x, y, theta, make_prior())
    assert model.jitter == pytest.approx(RELATIVE_JITTERS[1], rel=1e-9)
    assert "jitter 1.0e-12 on the covariance's diagonal" in model.repair
    unique = condition(np.delete(x, 7, axis=0), np.delete(y, 7), theta, make_prior())
    points = np.vstack([x, generator.uniform(-2, 2, (10, 3))])
    np.testing.assert_allclose(model.predict(points), unique.predict(points), atol=1e-6)
    assert_sound(model, points)


def test_rows_that_no_jitter_parts_are_named():
    inputs = np.array([[0.0, 0.0], [5.0, 5.0], [1.0, 2.0], [1.0, 2.0 + 1e-9]])
    impossible = np.eye(4)
    impossible[2, 3] = impossible[3, 2] = 1.001
    told = (
        r"the covariance of 4 points is not positive definite: rows 2 and 3 are nearly the same \(distance 1e-09\); "
        "remove one or raise the noise"
    )
    with pytest.raises(FactorisationError, match=told):
        factorise(impossible, inputs)
    with pytest.raises(FactorisationError, match="the covariance of 1 points is not positive definite: rows 0 and 0"):
        factorise(-np.eye(1), inputs[:1])


@pytest.mark.parametrize(("shift", "jitter"), [(0.0, 0.0), (-5e-13, 1e-12), (-5e-11, 1e-10), (-5e-9, 1e-8)])
def test_the_smallest_jitter_that_helps_is_taken(shift, jitter):
    axis = np.array([1.0, 1.0, 1.0, 1.0])[:, None] / 2
    covariance = np.eye(4) - (1 - shift if shift else 0.5) * (axis @ axis.T)
    factor = factorise(covariance, np.arange(4.0)[:, None])
    assert factor.jitter == pytest.approx(jitter * np.mean(np.diag(covariance)))
    np.testing.assert_allclose(factor.lower @ factor.lower.T, covariance + factor.jitter * np.eye(4), atol=1e-15)
    np.testing.assert_allclose(factor.inverse @ factor.lower, np.eye(4), atol=1e-9)


def test_constant_outputs_are_a_right_answer_and_a_constant_column_leaves_its_length_to_the_hyperprior(generator):
    x, y = make_data(generator, 15)
    x[:, 1] = 0.3
    prior = make_prior()
    model = fit(x, y, prior, generator=generator)
    assert model.theta[1] == pytest.approx(prior.mean[1], abs=1e-6)
    assert model.laplace.covariance[1, 1] == pytest.approx(prior.variance[1], rel=1e-6)
    assert_sound(model, generator.uniform(-2, 2, (10, 3)))
    x = generator.uniform(-1.5, 1.5, (12, 3))
    for y in (np.zeros(12), np.ones(12)):
        model = fit(x, y, make_prior(), generator=generator)
        assert_sound(model, x)
        np.testing.assert_allclose(model.predict(x)[0], y, atol=0.1)


@pytest.mark.parametrize("scale", [1e-40, 1e-12, 1e-6, 1e3, 1e6, 1e12, 1e40])
def test_inputs_of_any_scale_give_the_same_answer_when_the_lengths_follow(scale, generator):
    x, y = make_data(generator, 12)
    points = generator.uniform(-2, 2, (10, 3))
    theta = THETA + np.log(scale) * np.array([1, 1, 1, 0, 0])
    if abs(np.log(scale)) > 49:
        with pytest.raises(FactorisationError, match="expected logarithms between -50 and 50"):
            condition(scale * x, y, theta, make_prior()).predict(scale * points)
        return
    scaled, plain = condition(scale * x, y, theta, make_prior()), condition(x, y, THETA, make_prior())
    np.testing.assert_allclose(scaled.predict(scale * points), plain.predict(points), rtol=1e-9)
    for ours, expected in zip(scaled.sensitivities(scale * points), plain.sensitivities(points), strict=True):
        np.testing.assert_allclose(ours, expected, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("scale", [1e-45, 1e-9, 1e9, 1e45])
@pytest.mark.parametrize("of", ["inputs", "outputs", "both"])
def test_data_that_were_not_standardised_still_fit(scale, of, generator):
    x, y = make_data(generator, 10)
    x = x * (scale if of != "outputs" else 1.0)
    y = y * (scale if of != "inputs" else 1.0)
    model = fit(x, y, make_prior(), generator=generator)
    assert np.isfinite(model.log_posterior)
    assert_sound(model, np.vstack([x, 1.1 * x]))


@pytest.mark.parametrize("entry", range(6))
@pytest.mark.parametrize("value", [-1e4, -400.0, -51.0, 51.0, 400.0, 1e4, np.inf, np.nan])
def test_a_theta_that_would_overflow_is_refused(entry, value, generator):
    x, y = make_data(generator, 5)
    value = value * 1e200 if entry == 5 else value
    theta = np.append(THETA, 0.0)
    theta[entry] = value
    posterior = LogPosterior(x, y, make_prior(mean="constant"), "constant")
    told = r"a constant mean within 1e\+50" if entry == 5 else "logarithms between -50 and 50"
    for evaluate in (posterior.value, posterior.ascent, posterior.derivatives, posterior.factor):
        with pytest.raises(FactorisationError, match=f"theta: expected {told}"):
            evaluate(theta)
    with pytest.raises(FactorisationError, match=f"theta: expected {told}"):
        SparsePosterior(x, y, None, "constant").value(x[:2], theta)


@np.vectorize(otypes=[object])
def exact(value):
    return mpmath.mpf(float(value))


def predict_exactly(x, y, theta, points):
    """Return mean and variance with 40 digits, from differences and an LU decomposition."""
    with mpmath.workdps(40):
        exponential = np.vectorize(mpmath.exp, otypes=[object])
        lengths, (signal, noise) = exponential(exact(theta[:3])), exponential(2 * exact(theta[3:]))

        def kernel(left, right):
            squares = ((exact(left)[:, None] - exact(right)[None]) / lengths) ** 2
            return signal * exponential(-squares.sum(axis=2) / 2)

        inverse = mpmath.inverse(mpmath.matrix((kernel(x, x) + noise * np.eye(len(x), dtype=int)).tolist()))
        k = kernel(points, x)
        weights = k @ np.array(inverse.tolist(), dtype=object)
        return (weights @ exact(y)).astype(float), (signal - (weights * k).sum(axis=1)).astype(float)


@pytest.mark.parametrize("log_noise", [np.log(1e-3), np.log(1e-4)])
def test_low_noise_variances_agree_with_40_digits(log_noise, generator):
    x, y = make_data(generator, 30, noise=1e-4)
    theta = np.array([0.7, 0.6, 0.8, 0.3, log_noise])
    points = np.vstack([x[:4], generator.uniform(-1.5, 1.5, (12, 3)), [[9.0, 9.0, 9.0]]])
    model = condition(x, y, theta, make_prior())
    mean, variance = model.predict(points)
    exact_mean, exact_variance = predict_exactly(x, y, theta, points)
    assert exact_variance.min() < 1e-5 * np.exp(0.6)
    assert np.abs(variance - exact_variance).max() <= 1e-9
    assert np.abs(mean - exact_mean).max() <= 1e-6
    assert model.jitter == 0.0
