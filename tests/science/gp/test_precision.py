import mpmath
import numpy as np
import pytest

from stages.science.gp.marginal import condition
from tests.science.gp.data import make_data, make_prior


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
