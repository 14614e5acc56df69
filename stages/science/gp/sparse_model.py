"""A sparse GP at given pseudo-inputs and hyperparameters: its predictions.

A `SparsePosterior`, pseudo-inputs and theta flow in, predictions at many points flow out. In the terms of `sparse`,
with v = L^-1 k_m(x*)::

    mean        m + v' beta = m + w' k_m(x*), with w = L^-T beta
    variance    sf^2 - v'v + v' B^-1 v, of f; sn^2 more for y
"""

import numpy as np

from stages.science.gp.cross import choose_cross
from stages.science.gp.kernel import Array, Hyperparameters
from stages.science.gp.posterior import check_points
from stages.science.gp.sparse import SparsePosterior, blocks


class SparseGP:
    """A sparse GP of a posterior's data and hyperprior at given pseudo-inputs and hyperparameters.

    The pseudo-inputs, (M, D), are in the units of the data's inputs, theta is (P,). A `ValueError` tells a shape that
    does not fit or a pseudo-input that is not finite, a `FactorisationError` a theta out of range or a noise too low.

    Attributes
    ----------
    centre : (D,) float array
        Of the data's inputs.
    scaled : (M, D) float array
        Pseudo-inputs less the centre, in units of the lengths.
    whiten, inner : (M, M) float arrays
        L^-1, and the inverse of B's factor.
    beta, weights : (M,) float arrays
        B^-1 V Lam^-1 r, and w = L^-T beta: the mean is m + w' k_m(x*) too.
    """

    def __init__(self, posterior: SparsePosterior, pseudo: Array, theta: Array):
        self.pseudo, self.theta = np.array(pseudo, dtype=float), np.array(theta, dtype=float)
        self.log_posterior = posterior.value(self.pseudo, self.theta)
        at = posterior.condition(self.pseudo, self.theta)
        self.hyperparameters, self.log_likelihood = at.read, at.log_likelihood
        self.repair = at.factor.repair
        self.centre, self.scaled = posterior.centre, at.scaled
        self.whiten, self.inner, self.beta = at.factor.inverse, at.inner.inverse, at.beta
        self.weights = self.whiten.T @ self.beta

    @property
    def noise_variance(self) -> float:
        """sn^2."""
        return self.hyperparameters.noise_variance

    def predict_mean(self, points: Array) -> Array:
        """Return the predictive mean of (B, D) points, (B,)."""
        return predict_weighted(self.pseudo, self.weights, self.theta, points)

    def predict(self, points: Array) -> tuple[Array, Array]:
        """Return the predictive mean and variance of f at (B, D) points, (B,) each."""
        points = check_points(points, self.centre.size)
        read, m = self.hyperparameters, len(self.pseudo)
        floor = m * np.finfo(float).eps * read.signal_variance
        mean, variance = np.empty((2, len(points)))
        for block in blocks(len(points)):
            columns = ((points[block] - self.centre) / read.lengths).T
            cross = choose_cross(self.scaled, columns, read.signal_variance, read.noise_variance)
            v = self.whiten @ cross.covariance(slice(None), np.empty((m, columns.shape[1])))
            w = self.inner @ v
            mean[block] = self.beta @ v + read.mean
            prior = np.maximum(read.signal_variance - np.einsum("mn,mn->n", v, v), floor)
            variance[block] = prior + np.einsum("mn,mn->n", w, w)
        return mean, variance


def predict_weighted(pseudo: Array, weights: Array, theta: Array, points: Array) -> Array:
    """Return the predictive mean m + w' k_m(x*), (B,), that a sparse GP's weights stand for, without its data.

    Of (M, D) pseudo-inputs, (M,) weights w and (P,) hyperparameters, at (B, D) points: a `ValueError` tells another
    shape or what is not finite.
    """
    points, read = check_points(points, pseudo.shape[1]), Hyperparameters.read(theta, pseudo.shape[1])
    centre = pseudo.mean(axis=0)
    scaled = (pseudo - centre) / read.lengths
    mean = np.empty(len(points))
    for block in blocks(len(points)):
        columns = ((points[block] - centre) / read.lengths).T
        cross = choose_cross(scaled, columns, read.signal_variance, read.noise_variance)
        mean[block] = weights @ cross.covariance(slice(None), np.empty((len(pseudo), columns.shape[1]))) + read.mean
    return mean
