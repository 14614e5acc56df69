import mpmath
import numpy as np
import pytest

from stages.science.gp.marginal import condition
from tests.science.gp.data import make_data, make_prior


def exact(x, y, theta, points):
    """Return mean and variance with 40 digits, from differences and an LU decomposition."""
    with mpmath.workdps(40):
        entries = [mpmath.mpf(float(each)) for each in theta]
        lengths, signal, noise = (
            [mpmath.exp(each) for each in entries[:3]],
            mpmath.exp(2 * entries[3]),
            mpmath.exp(2 * entries[4]),
        )

        def kernel(first, second):
            return signal * mpmath.exp(
                -sum(
                    ((mpmath.mpf(float(p)) - mpmath.mpf(float(q))) / length) ** 2
                    for p, q, length in zip(first, second, lengths, strict=True)
                )
                / 2
            )

        covariance = mpmath.matrix(
            [[kernel(p, q) + (noise if i == j else 0) for j, q in enumerate(x)] for i, p in enumerate(x)]
        )
        inverse = mpmath.inverse(covariance)
        outputs = mpmath.matrix([mpmath.mpf(float(each)) for each in y])
        means, variances = [], []
        for point in points:
            k = mpmath.matrix([kernel(point, q) for q in x])
            weights = inverse * k
            means.append(float((weights.T * outputs)[0]))
            variances.append(float(signal - (k.T * weights)[0]))
    return np.array(means), np.array(variances)


@pytest.mark.parametrize("log_noise", [np.log(1e-3), np.log(1e-4)])
def test_low_noise_variances_agree_with_40_digits(log_noise, generator):
    x, y = make_data(generator, 30, noise=1e-4)
    theta = np.array([0.7, 0.6, 0.8, 0.3, log_noise])
    points = np.vstack([x[:4], generator.uniform(-1.5, 1.5, (12, 3)), [[9.0, 9.0, 9.0]]])
    model = condition(x, y, theta, make_prior())
    mean, variance = model.predict(points)
    exact_mean, exact_variance = exact(x, y, theta, points)
    assert exact_variance.min() < 1e-5 * np.exp(0.6)
    assert np.abs(variance - exact_variance).max() <= 1e-9
    assert np.abs(mean - exact_mean).max() <= 1e-6
    assert model.jitter == 0.0
