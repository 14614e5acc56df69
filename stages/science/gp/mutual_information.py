"""What measurements tell about the hyperparameters, by Monte Carlo: the yardstick of the utilities.

A `MarginalGP` flows in; for each draw of theta from its Laplace approximation the information density
log p(y | theta) - log p(y) of outputs at that draw flows out, whose mean over draws is I(y; theta) in nats. p(y) is the
mean of p(y | theta) over the same draws (nested Monte Carlo): no estimate exceeds the logarithm of their number.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from stages.science.gp.factor import Factor, factorise
from stages.science.gp.kernel import Array, Hyperparameters
from stages.science.gp.marginal import MarginalGP
from stages.science.gp.posterior import LogPosterior, check_points

NODES = 6
"""Of the Gauss-Hermite rule over the output at one point, exact for polynomials of degree 11."""

LARGEST_BLOCK = 200_000
"""Numbers that an intermediate array holds where it can be split, 1.6 MB: about a processor's cache."""


@dataclass(frozen=True)
class Information:
    """An estimate by draws (nats), and its standard error over them."""

    value: float
    standard_error: float

    @classmethod
    def of(cls, densities: Array) -> Information:
        """Return the mean of (S,) information densities, and its standard error."""
        return cls(float(densities.mean()), float(densities.std(ddof=1) / np.sqrt(densities.size)))


def draw_models(model: MarginalGP, draws: int, generator: np.random.Generator) -> list[Draw]:
    """Return the model at each of at least two draws of theta from its Laplace approximation.

    A `FactorisationError` tells a draw that is out of a range that keeps all that follows from it finite.
    """
    if draws < 2:
        raise ValueError(f"draws: expected at least 2, got {draws}")
    steps = generator.standard_normal((draws, model.theta.size)) @ model.laplace.root.T
    return [Draw.at(model.posterior, model.theta + step) for step in steps]


def point_information(models: list[Draw], points: Array) -> Array:
    """Return the information densities of one measurement at each of (B, D) points, (S, B), in nats.

    The output at each of S draws is normal, so that its density is integrated by Gauss and Hermite's rule.
    """
    points = check_points(points, models[0].inputs.shape[1])
    rounding = len(models[0].inputs) * float(np.finfo(float).eps)
    means, variances = np.empty((2, len(models), len(points)))
    for index, draw in enumerate(models):
        v = draw.whiten(points)
        means[index] = draw.predict(v)
        explained = np.einsum("nb,nb->b", v, v)
        variances[index] = np.maximum(draw.read.signal_variance - explained, rounding * draw.read.signal_variance)
        variances[index] += draw.read.noise_variance
    means -= means.mean(axis=0)
    roots, weights = np.polynomial.hermite_e.hermegauss(NODES)
    weights = weights / weights.sum()
    densities = np.zeros_like(means)
    for block in _split(len(points), len(models) ** 2):
        mean, variance = means[:, block].T, variances[:, block].T
        # log p(y | theta_j) = c0_j + c1_j y + c2_j y^2
        constants = -0.5 * (mean**2 / variance + np.log(variance))
        coefficients = np.stack([constants, mean / variance, -0.5 / variance], axis=1)
        for root, weight in zip(roots, weights, strict=True):
            outputs = mean + root * np.sqrt(variance)
            logs = np.stack([np.ones_like(outputs), outputs, outputs**2], axis=2) @ coefficients
            logs -= -0.5 * (root**2 + np.log(variance))[:, :, None]
            densities[:, block] -= weight * np.log(np.exp(logs, out=logs).mean(axis=2)).T
    return densities


def path_information(models: list[Draw], paths: Array, noise: Array) -> Array:
    """Return the information densities of noisy measurements at all T points of each path together, (S, R), in nats.

    The models are at S draws of theta, the paths, (R, T, D), standardised; the noise, (K, S, T), are standard normal
    draws: K outputs at each draw of theta, the same for all paths.
    """
    count, samples, dimensions = paths.shape
    check_points(paths.reshape(-1, dimensions), models[0].inputs.shape[1])
    densities = np.empty((len(models), count))
    for block in _split(count, len(models) * samples**2):
        found = [each.predict_jointly(paths[block]) for each in models]
        means, roots = (np.array(each) for each in zip(*found, strict=True))
        inverses = np.linalg.inv(roots)
        for index in range(means.shape[1]):
            told = _compare_outputs(means[:, index], roots[:, index], inverses[:, index], noise)
            densities[:, block.start + index] = told.mean(axis=0)
    return densities


def _compare_outputs(means: Array, roots: Array, inverses: Array, noise: Array) -> Array:
    """Return log p(y | theta) - log p(y) of K outputs along one path at each draw, (K, S), all else as found there."""
    samples = means.shape[1]
    outputs = (means + np.einsum("sij,ksj->ksi", roots, noise)).reshape(-1, samples)
    halves = np.log(np.diagonal(inverses, axis1=1, axis2=2)).sum(axis=1)
    centres = inverses @ means[:, :, None]
    logs = np.empty((len(means), len(outputs)))
    for block in _split(len(means), outputs.size):
        whitened = (inverses[block].reshape(-1, samples) @ outputs.T).reshape(-1, samples, len(outputs))
        whitened -= centres[block]
        logs[block] = halves[block, None] - 0.5 * np.einsum("sto,sto->so", whitened, whitened)
    own = (halves - 0.5 * np.square(noise).sum(axis=2)).ravel()
    logs -= own
    largest = logs.max(axis=0)
    told: Array = -largest - np.log(np.exp(logs - largest).mean(axis=0))
    return told.reshape(noise.shape[:2])


@dataclass(frozen=True)
class Draw:
    """What a model of (N, D) inputs predicts with at one draw of theta: L of C, and L^-1 (y - m), (N,)."""

    inputs: Array
    read: Hyperparameters
    factor: Factor
    residual: Array

    @classmethod
    def at(cls, posterior: LogPosterior, theta: Array) -> Draw:
        """Factorise once for all predictions."""
        factor = posterior.factor(theta)
        return cls(posterior.inputs, posterior.read(theta), factor, factor.whiten(posterior.residual(theta)))

    def whiten(self, points: Array) -> Array:
        """Return v = L^-1 k of (B, D) points, (N, B)."""
        return self.factor.whiten(self.covariance(self.inputs, points))

    def predict(self, v: Array) -> Array:
        """Return the mean, (B,), from v (N, B)."""
        return np.asarray(self.residual @ v + self.read.mean)

    def predict_jointly(self, paths: Array) -> tuple[Array, Array]:
        """Return the mean (R, T) of the noisy outputs along paths, and the lower factors (R, T, T) of covariances."""
        count, samples, dimensions = paths.shape
        v = self.whiten(paths.reshape(-1, dimensions))
        along = v.reshape(-1, count, samples).transpose(1, 2, 0)
        covariance = self.covariance(paths, paths) - along @ along.transpose(0, 2, 1)
        covariance[:, range(samples), range(samples)] += self.read.noise_variance
        try:
            roots = np.asarray(np.linalg.cholesky(covariance), dtype=float)
        except np.linalg.LinAlgError:
            pairs = zip(covariance, paths, strict=True)
            roots = np.array([factorise(each, path / self.read.lengths).lower for each, path in pairs])
        mean: Array = self.predict(v).reshape(count, samples)
        return mean, roots

    def covariance(self, left: Array, right: Array) -> Array:
        """Return the (..., N, B) covariance between rows (..., N, D) and (..., B, D)."""
        exponent = np.zeros((*left.shape[:-1], right.shape[-2]))
        for index, length in enumerate(self.read.lengths):
            difference = (left[..., :, None, index] - right[..., None, :, index]) / length
            exponent -= 0.5 * np.square(difference, out=difference)
        return np.asarray(self.read.signal_variance * np.exp(exponent, out=exponent))


def _split(count: int, numbers: int) -> Iterator[slice]:
    """Yield blocks of `count` things, each of which takes so many numbers."""
    size = max(1, LARGEST_BLOCK // max(1, numbers))
    for start in range(0, count, size):
        yield slice(start, min(start + size, count))
