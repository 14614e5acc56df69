"""Predictive mean and variance of f at many points, and their derivatives by theta.

A model's parts and (B, D) points flow in, chunk by chunk; means, variances and slopes of (B,) points flow out. With
k = k(X, x*), C the noisy covariance L L', v = L^-1 k, b = C^-1 k, a = C^-1 (y - m) and K_d = K o D_d, where D_d holds
the squared differences of input d in units of its length:

    m = k'a + mean              dm/dlog l_d = sum_n a_n k_n (x_nd - x*_d)^2 / l_d^2 - k' C^-1 K_d a
    V = sf^2 - v'v              dV/dlog l_d = -2 |L' (b o (x_d - x*_d))|^2 / l_d^2
    dm/dlog sf = -dm/dlog sn = 2 sn^2 b'a     dV/dlog sn = 2 sn^2 b'b     dV/dlog sf = 2 V - 2 sn^2 b'b

The second line's norm is b' K_d b - 2 (k o D_d)' b with C b = k put in: a longer length never raises V, and nothing
cancels.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np

from stages.science.gp.distance import Direct, Expanded, Triangle, keeps_digits
from stages.science.gp.factor import Factor
from stages.science.gp.kernel import Array
from stages.science.gp.posterior import LogPosterior

LARGEST_CHUNK = 1008
"""Points at a time: working memory then stays in the processor's cache at the sizes of this method, and rows begin in
other sets of it, as they would not with a power of two."""


@dataclass(frozen=True)
class Moments:
    """Mean and variance of f at B points, (B,), with their derivatives by theta, (P, B).

    The variance is at least its rounding error, `Predictor.floor`.
    """

    mean: Array
    variance: Array
    mean_slope: Array
    variance_slope: Array


def limit_chunk(numbers_per_point: int, memory_mb: float) -> int:
    """Return how many points, each of which takes so many numbers of working memory, are worked on at a time."""
    return int(max(1, min(LARGEST_CHUNK, memory_mb * 2**20 // (8 * numbers_per_point))))


class Predictor:
    """Predicts chunks of at most `size` points, with working memory of its own.

    The factor is that of the noisy covariance of the posterior's N data at theta, (P,); the (N,) weights are a.
    """

    def __init__(self, posterior: LogPosterior, theta: Array, factor: Factor, weights: Array, size: int):
        self.read = posterior.read(theta)
        self.size = theta.size
        inputs = posterior.inputs
        n = len(inputs)
        self._noise = self.read.noise_variance + factor.jitter
        self._centre = inputs.mean(axis=0)
        scaled = (inputs - self._centre) / self.read.lengths
        self._weights = weights
        kept = keeps_digits(scaled, self.read.signal_variance, self._noise)
        find_rows = partial(_find_rows, posterior, theta, factor, weights)
        self._distances = (Expanded if kept else Direct)(scaled, self.read.signal_variance, factor, find_rows, size)
        self._whiten = Triangle(factor.inverse, lower=True)
        self._unwhiten = Triangle(factor.inverse.T, lower=False)
        self._v, self._b = np.empty((2, n, size))
        self.floor = n * float(np.finfo(float).eps) * self.read.signal_variance

    def predict_mean(self, points: Array) -> Array:
        """Return the mean, (B,)."""
        return np.asarray(self._weights @ self._distances.covariance(self._scale(points)) + self.read.mean)

    def predict(self, points: Array) -> tuple[Array, Array]:
        """Return mean and variance, (B,) each."""
        v, k = self._whiten_covariance(self._scale(points))
        return self._weights @ k + self.read.mean, self._variance(np.einsum("nb,nb->b", v, v))

    def whiten(self, points: Array) -> Array:
        """Return v, (N, B); it is reused by the next call."""
        return self._whiten_covariance(self._scale(points))[0]

    def differentiate(self, points: Array) -> Moments:
        """Return mean and variance with their derivatives."""
        at = self._scale(points)
        d, count = at.shape
        v, k = self._whiten_covariance(at)
        b = self._unwhiten.multiply(v, self._b[:, :count])
        explained = np.einsum("nb,nb->b", v, v)
        variance = self._variance(explained)
        linear, slopes = self._distances.mean_slopes(at, k)

        dm, dv = np.empty((2, self.size, count))
        dv[d + 2 :] = 0.0
        dm[:d] = slopes
        np.multiply(linear[1], 2.0 * self._noise, out=dm[d])
        np.multiply(linear[1], -2.0 * self.read.noise_variance, out=dm[d + 1])
        dm[d + 2 :] = 1.0 - linear[2:]
        squared = np.einsum("nb,nb->b", b, b)
        dv[:d] = -2.0 * self._distances.variance_spread(at, k, b, explained)
        dv[d] = 2.0 * (variance - self._noise * squared)
        dv[d + 1] = 2.0 * self.read.noise_variance * squared
        return Moments(linear[0] + self.read.mean, variance, dm, dv)

    def _whiten_covariance(self, at: Array) -> tuple[Array, Array]:
        k = self._distances.covariance(at)
        return self._whiten.multiply(k, self._v[:, : at.shape[1]]), k

    def _scale(self, points: Array) -> Array:
        at = np.array(points.T, order="C")  # long rows first: each operation is on few of them
        at -= self._centre[:, None]
        at /= self.read.lengths[:, None]
        return at

    def _variance(self, explained: Array) -> Array:
        return np.maximum(self.read.signal_variance - explained, self.floor)


def _find_rows(posterior: LogPosterior, theta: Array, factor: Factor, weights: Array) -> tuple[Array, Array]:
    """Return the rows that are multiplied with k, a first, and c_d of each length."""
    covariance, columns = posterior.covariance(theta), (posterior.inputs / posterior.read(theta).lengths).T
    rows = [weights, factor.solve(weights)] + [factor.solve(np.ones(len(weights)))] * (posterior.mean == "constant")
    corrections = [factor.solve(((column[:, None] - column) ** 2 * covariance) @ weights) for column in columns]
    return np.vstack(rows), np.vstack(corrections)
