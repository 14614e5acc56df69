"""What measurements tell about the hyperparameters, by Monte Carlo: the yardstick of the utilities.

A `MarginalGP` and draws of theta from its Laplace approximation flow in; for each draw the information density
log p(y | theta) - log p(y) of outputs drawn at it flows out, whose mean over draws is I(y; theta) in nats. p(y) is
the mean of p(y | theta) over the same draws (nested Monte Carlo), so that no estimate exceeds the logarithm of their
number.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.special import logsumexp

from stages.gp.factor import factorise
from stages.gp.kernel import Hyperparameters, covariance_among, squared_differences
from stages.gp.marginal import MarginalGP
from stages.gp.posterior import check_points

Array = NDArray[np.float64]

NODES = 6
"""Of the Gauss-Hermite rule over the output at one point, exact for polynomials of degree 11."""

LARGEST_BLOCK = 4_000_000
"""Densities that are held at a time, 32 MB."""

SMALLEST_DRAWS = 2


@dataclass(frozen=True)
class Information:
    """An estimate by draws.

    Parameters
    ----------
    value : float
        Nats.
    standard_error : float
        Over the draws.
    """

    value: float
    standard_error: float

    @classmethod
    def of(cls, densities: Array) -> Information:
        """Return the mean of (S,) information densities, and its standard error."""
        return cls(float(densities.mean()), float(densities.std(ddof=1) / np.sqrt(densities.size)))


def draw_models(model: MarginalGP, draws: int, generator: np.random.Generator) -> list[MarginalGP]:
    """Return the model at each of many draws of theta from its Laplace approximation.

    Raises
    ------
    ValueError
        With fewer than two draws.
    FactorisationError
        When a draw is out of a range that keeps all that follows from it finite.
    """
    if draws < SMALLEST_DRAWS:
        raise ValueError(f"draws: expected at least {SMALLEST_DRAWS}, got {draws}")
    steps = generator.standard_normal((draws, model.theta.size)) @ model.laplace.root.T
    return [MarginalGP(model.posterior, model.theta + step, model.laplace.covariance) for step in steps]


def point_information(models: list[MarginalGP], points: Array, noisy: bool = True) -> Array:
    """Return the information densities of one measurement at each of (B, D) points, (S, B), in nats.

    Parameters
    ----------
    models : list of MarginalGP
        At S draws of theta.
    points : (B, D) float array
        Standardised.
    noisy : bool
        Whether y is measured, or f itself.

    Notes
    -----
    The output at one draw is normal, so that its density is integrated by Gauss and Hermite's rule instead of drawn.
    """
    found = np.array([each.predict(points) for each in models])
    means, variances = found[:, 0], found[:, 1]
    if noisy:
        variances = variances + np.array([each.noise_variance for each in models])[:, None]
    nodes, weights = np.polynomial.hermite_e.hermegauss(NODES)
    weights = weights / weights.sum()
    entropies = 0.5 * (1.0 + np.log(2 * np.pi * variances))
    densities = np.empty_like(means)
    edges = np.append(np.arange(0, means.shape[1], max(1, LARGEST_BLOCK // len(models) ** 2)), means.shape[1])
    for start, stop in pairwise(edges):
        block = slice(start, stop)
        mean, variance = means[:, block], variances[:, block]
        marginal = np.zeros_like(mean)
        for node, weight in zip(nodes, weights, strict=True):
            outputs = mean + node * np.sqrt(variance)
            squares = (outputs[:, None] - mean[None]) ** 2 / variance[None]
            logs = -0.5 * (squares + np.log(2 * np.pi * variance)[None])
            marginal += weight * (logsumexp(logs, axis=1) - np.log(len(models)))
        densities[:, block] = -entropies[:, block] - marginal
    return densities


def path_information(models: list[MarginalGP], path: Array, noise: Array) -> Array:
    """Return the information densities of noisy measurements at all (T, D) points together, (S,), in nats.

    Parameters
    ----------
    models : list of MarginalGP
        At S draws of theta.
    path : (T, D) float array
        Standardised.
    noise : (K, S, T) float array
        Standard normal draws: K outputs at each draw of theta, the same for paths that are to be compared.
    """
    moments = [predict_jointly(each, path) for each in models]
    means = np.array([each[0] for each in moments])
    roots = np.array([each[1] for each in moments])
    halves = np.log(np.diagonal(roots, axis1=1, axis2=2)).sum(axis=1)
    densities = np.empty(noise.shape[:2])
    for k, drawn in enumerate(noise):
        outputs = means + np.einsum("sij,sj->si", roots, drawn)
        logs = np.empty((len(models), len(models)))
        for s, root in enumerate(roots):
            whitened = solve_triangular(root, (outputs - means[s]).T, lower=True)
            logs[:, s] = -halves[s] - 0.5 * np.square(whitened).sum(axis=0)
        own = -halves - 0.5 * np.square(drawn).sum(axis=1)
        densities[k] = own - (logsumexp(logs, axis=1) - np.log(len(models)))
    mean: Array = densities.mean(axis=0)
    return mean


def predict_jointly(model: MarginalGP, path: Array) -> tuple[Array, Array]:
    """Return the mean (T,) of the noisy outputs along a path, and the lower factor (T, T) of their covariance."""
    path = check_points(path, model.inputs.shape[1])
    read = model.hyperparameters
    factor = model.posterior.factor(model.theta)
    cross = covariance_between(model.inputs, path, read)
    v = factor.whiten(cross)
    covariance = covariance_among(squared_differences(path), read) - v.T @ v
    covariance.flat[:: len(path) + 1] += read.noise_variance
    mean = v.T @ factor.whiten(model.posterior.residual(model.theta)) + read.mean
    return mean, factorise(covariance, path / read.lengths).lower


def covariance_between(left: Array, right: Array, read: Hyperparameters) -> Array:
    """Return the (N, T) covariance between two sets of rows."""
    squares = np.square((left[:, None] - right[None]) / read.lengths).sum(axis=2)
    return np.asarray(read.signal_variance * np.exp(-0.5 * squares))
