"""Small data sets that the tests of the GP share, and what textbooks say of them."""

import numpy as np

from stages.science.gp.hyperprior import Hyperprior
from stages.science.gp.sparse import RELATIVE_JITTER
from stages.science.gp.utilities import UTILITIES


def make_data(generator, count, dimensions=3, noise=0.1):
    """Return (N, D) inputs and (N,) outputs of a smooth law with noise."""
    x = generator.uniform(-1.5, 1.5, (count, dimensions))
    y = np.sin(1.5 * x[:, 0]) + 0.4 * (x**2).sum(axis=1) - 0.5 * dimensions
    return x, y + noise * generator.standard_normal(count)


def make_prior(dimensions=3, mean="zero", log_noise=-2.0, variance=0.5):
    """Return a hyperprior around lengths and a signal of 1."""
    means = [0.0] * (dimensions + 1) + [log_noise] + [0.0] * (mean == "constant")
    return Hyperprior(np.array(means), np.full(len(means), variance))


def differences(function, at, step):
    """Return central differences of a function of a vector, one row for each entry."""
    rows = []
    for index in range(at.size):
        shift = np.zeros_like(at)
        shift[index] = step
        rows.append((np.asarray(function(at + shift)) - np.asarray(function(at - shift))) / (2 * step))
    return np.array(rows)


def assert_sound(model, points, ask=lambda evaluate, *given: evaluate(*given)):
    """Check all that a model tells of points against what must hold for every model; an answer may be None."""
    count, signal = len(points), model.hyperparameters.signal_variance
    plain, marginal = ask(model.predict, points), ask(model.predict_marginal, points)
    if plain is not None:
        assert plain[0].shape == plain[1].shape == (count,)
        assert np.isfinite(plain[0]).all()
        assert (plain[1] > 0).all()
        assert (plain[1] <= signal * (1 + 1e-14)).all()
        assert ask(model.predict_mean, points).shape == (count,)
    if marginal is not None:
        assert np.isfinite(marginal).all()
        assert (marginal[1] >= 4 / 3 * plain[1] * (1 - 1e-14)).all()
    for name in UTILITIES:
        scores = ask(model.utility, points, name)
        if scores is not None:
            assert scores.shape == (count,)
            assert np.isfinite(scores).all()
            assert name not in ("y_y", "y_y_theta", "hyperparameter_information") or (scores >= 0).all()
    joint = ask(model.joint_information, points)
    if joint is not None:
        assert np.isfinite(joint)
        assert joint >= -1e-12


def kernel(left, right, theta):
    """Return the covariance of f at one set of points with f at another."""
    d = left.shape[1]
    squares = (((left[:, None] - right[None]) / np.exp(theta[:d])) ** 2).sum(axis=2)
    return np.exp(2 * theta[d] - 0.5 * squares)


class Textbook:
    """A Gaussian process by whole matrices and plain numpy."""

    def __init__(self, x, y, theta):
        d = x.shape[1]
        self.x, self.theta, self.signal = x, theta, np.exp(2 * theta[d])
        self.mean = theta[d + 2] if theta.size > d + 2 else 0.0
        self.covariance = self.cover(x) + np.exp(2 * theta[d + 1]) * np.eye(len(x))
        self.residual = y - self.mean

    def cover(self, x):
        """Return the covariance of f at the data."""
        return kernel(x, x, self.theta)

    def cross(self, points):
        """Return the covariance of f at points with f at the data."""
        return kernel(points, self.x, self.theta)

    @property
    def log_likelihood(self):
        fit = self.residual @ np.linalg.solve(self.covariance, self.residual)
        return -0.5 * (fit + np.linalg.slogdet(2 * np.pi * self.covariance)[1])

    def predict(self, points):
        """Return mean and variance of f."""
        cross = self.cross(points)
        weights = np.linalg.solve(self.covariance, cross.T)
        return self.mean + weights.T @ self.residual, self.signal - np.einsum("bn,nb->b", cross, weights)


class Dense(Textbook):
    """A sparse Gaussian process by N x N matrices."""

    def __init__(self, x, y, pseudo, theta):
        self.pseudo = pseudo
        super().__init__(x, y, theta)

    def low_rank(self, left, right, theta):
        among = kernel(self.pseudo, self.pseudo, theta)
        among += RELATIVE_JITTER * among[0, 0] * np.eye(len(among))
        return kernel(left, self.pseudo, theta) @ np.linalg.solve(among, kernel(self.pseudo, right, theta))

    def cover(self, x):
        low_rank = self.low_rank(x, x, self.theta)
        return low_rank + np.diag(self.signal - np.diag(low_rank))

    def cross(self, points):
        return self.low_rank(points, self.x, self.theta)
