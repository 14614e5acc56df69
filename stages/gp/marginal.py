"""A Gaussian process at the MAP of its hyperparameters, and the marginal GP around it.

Data, hyperprior and theta flow in; predictions, their derivatives by theta and the utilities of many points flow out,
in batches of matrix products whose working memory is bounded. With k = k(X, x*), v = L^-1 k, b = C^-1 k and
a = C^-1 (y - m):

    m = k'a + mean        V = sf^2 - v'v
    dm/dtheta is linear in k; dV/dlog l_d = -2 (k o D_d)'b + b'(K o D_d) b with moments of k o b for the first term
    dV/dlog sn = 2 sn^2 b'b       dV/dlog sf = 2 V - 2 sn^2 b'b       dm/dlog sf = -dm/dlog sn = 2 sn^2 b'a
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from stages.gp.estimation import find_map
from stages.gp.factor import Factor, factorise
from stages.gp.hyperprior import Hyperprior
from stages.gp.kernel import Hyperparameters, cross_covariance
from stages.gp.laplace import Laplace, approximate
from stages.gp.posterior import LogPosterior
from stages.gp.utilities import PredictiveTerms, find_utility

Array = NDArray[np.float64]

LARGEST_CHUNK = 4096


class MarginalGP:
    """An exact GP at given hyperparameters, with their Laplace approximation.

    Parameters
    ----------
    posterior : LogPosterior
        Data and hyperprior.
    theta : (P,) float array
        Where to condition, usually the MAP.
    covariance : (P, P) float array, optional
        S, instead of the Laplace approximation at theta.
    memory_mb : float
        Bound on the working memory of predictions beyond their output (MB).
    """

    def __init__(self, posterior: LogPosterior, theta: Array, covariance: Array | None = None, memory_mb: float = 64.0):
        self.posterior = posterior
        self.theta = np.array(theta, dtype=float)
        self.memory_mb = memory_mb
        if self.theta.shape != posterior.prior.mean.shape:
            raise ValueError(f"theta: expected {posterior.prior.mean.size} entries, got shape {self.theta.shape}")
        self._given = covariance

    @cached_property
    def hyperparameters(self) -> Hyperparameters:
        """Theta, read."""
        return Hyperparameters.read(self.theta, self.inputs.shape[1])

    @property
    def inputs(self) -> Array:
        """(N, D) standardised inputs."""
        return self.posterior.inputs

    @property
    def noise_variance(self) -> float:
        """sn^2."""
        return self.hyperparameters.noise_variance

    @cached_property
    def _factor(self) -> Factor:
        return self.posterior.factor(self.theta)

    @property
    def jitter(self) -> float:
        """What the factorisation needed on the diagonal; 0 when nothing."""
        return self._factor.jitter

    @cached_property
    def _derivatives(self) -> tuple[float, Array, Array]:
        return self.posterior.derivatives(self.theta)

    @property
    def log_posterior(self) -> float:
        """At theta (nats)."""
        return self._derivatives[0]

    @cached_property
    def laplace(self) -> Laplace:
        """The Laplace approximation at theta, or the covariance that was given."""
        if self._given is not None:
            return Laplace(np.asarray(self._given, dtype=float), float(np.nan), "")
        return approximate(self._derivatives[2], self.posterior.prior)

    @property
    def repair(self) -> str:
        """What was repaired, for the record; empty when nothing was."""
        jittered = f"jitter {self.jitter:.1e} on the covariance's diagonal" if self.jitter else ""
        return "; ".join(each for each in (self.laplace.repair, jittered) if each)

    @cached_property
    def _weights(self) -> Array:
        return self._factor.solve(self.posterior.residual(self.theta))

    def with_memory(self, memory_mb: float) -> MarginalGP:
        """Return this model with another bound on the working memory of its predictions (MB)."""
        other = MarginalGP(self.posterior, self.theta, self._given, memory_mb)
        for name in ("_factor", "_derivatives", "laplace", "_weights", "_smooth"):
            if name in self.__dict__:
                other.__dict__[name] = self.__dict__[name]
        return other

    def grow(self, inputs: Array, outputs: Array) -> MarginalGP:
        """Return the model conditioned on more data, theta and S held."""
        posterior = LogPosterior(
            np.vstack([self.inputs, inputs]),
            np.concatenate([self.posterior.outputs, outputs]),
            self.posterior.prior,
            self.posterior.mean,
        )
        return MarginalGP(posterior, self.theta, self.laplace.covariance, self.memory_mb)

    def predict_mean(self, points: Array) -> Array:
        """Return the predictive mean of (B, D) points, (B,)."""
        return self._gather(points, 1, lambda chunk, k: (k @ self._weights + self.hyperparameters.mean)[:, None])[:, 0]

    def predict(self, points: Array) -> tuple[Array, Array]:
        """Return the predictive mean and variance of f at (B, D) points, (B,) each."""

        def evaluate(chunk: Array, k: Array) -> Array:
            v = k @ self._factor.inverse.T
            return np.stack([k @ self._weights + self.hyperparameters.mean, self._variance(v)], axis=1)

        found = self._gather(points, 2, evaluate)
        return found[:, 0], found[:, 1]

    def predict_marginal(self, points: Array) -> tuple[Array, Array]:
        """Return mean and variance of f with the hyperparameters marginalised, (B,) each.

        The mean is that of the plain GP (Garnett, Osborne and Hennig 2014).
        """
        found = self._gather(points, 3, self._terms)
        terms = PredictiveTerms(found[:, 1], found[:, 2], self.noise_variance)
        return found[:, 0], terms.marginal_variance

    def utility(self, points: Array, name: str) -> Array:
        """Return a point utility of (B, D) points, (B,).

        Raises
        ------
        ValueError
            When there is no utility of that name.
        """
        score = find_utility(name)
        found = self._gather(points, 3, self._terms)
        scores: Array = score(PredictiveTerms(found[:, 1], found[:, 2], self.noise_variance))
        return scores

    def sensitivities(self, points: Array) -> tuple[Array, Array]:
        """Return dm/dtheta and dV/dtheta at (B, D) points, (B, P) each."""
        size = self.theta.size

        def evaluate(chunk: Array, k: Array) -> Array:
            return np.hstack(self._differentiate(chunk, k)[2:])

        found = self._gather(points, 2 * size, evaluate)
        return found[:, :size], found[:, size:]

    def joint_information(self, points: Array) -> float:
        """Return the information that noisy measurements at all (T, D) points together bring about theta (nats).

        1/2 log det(I + S J' (V_TT + sn^2 I)^-1 J) with J = dm/dtheta.
        """
        k = cross_covariance(points, self.inputs, self.hyperparameters)
        v = k @ self._factor.inverse.T
        among = cross_covariance(points, points, self.hyperparameters)
        noisy = among - v @ v.T + self.noise_variance * np.eye(len(points))
        noisy.flat[:: len(points) + 1] = np.maximum(np.diag(noisy), self.noise_variance + self._floor)
        jacobian = factorise(noisy, points).whiten(self._differentiate(points, k)[2])
        root = np.linalg.cholesky(self.laplace.covariance)
        pulled = jacobian @ root
        return 0.5 * float(np.linalg.slogdet(np.eye(root.shape[0]) + pulled.T @ pulled)[1])

    def _gather(self, points: Array, columns: int, evaluate: Callable[[Array, Array], Array]) -> Array:
        points = np.asarray(points, dtype=float)
        if points.ndim != 2 or points.shape[1] != self.inputs.shape[1]:
            raise ValueError(f"points: expected shape (B, {self.inputs.shape[1]}), got {points.shape}")
        found = np.empty((len(points), columns))
        for rows in self._chunks(len(points)):
            chunk = points[rows]
            found[rows] = evaluate(chunk, cross_covariance(chunk, self.inputs, self.hyperparameters))
        return found

    def _chunks(self, count: int) -> Iterator[slice]:
        n, d = self.inputs.shape
        per_point = 8 * (7 * n + 12 * d + 24)
        size = int(max(1, min(LARGEST_CHUNK, self.memory_mb * 2**20 // per_point)))
        for start in range(0, count, size):
            yield slice(start, min(start + size, count))

    @property
    def _floor(self) -> float:
        return len(self.inputs) * np.finfo(float).eps * self.hyperparameters.signal_variance

    def _variance(self, v: Array) -> Array:
        return np.maximum(self.hyperparameters.signal_variance - np.einsum("bn,bn->b", v, v), self._floor)

    def _terms(self, chunk: Array, k: Array) -> Array:
        mean, variance, dm, dv = self._differentiate(chunk, k)
        covariance = self.laplace.covariance
        q = np.einsum("bp,bp->b", dm @ covariance, dm)
        known = variance <= self._floor
        q += np.where(known, 0.0, np.einsum("bp,bp->b", dv @ covariance, dv) / (3.0 * variance))
        return np.stack([mean, variance, q], axis=1)

    @cached_property
    def _smooth(self) -> tuple[Array, Array, Array]:
        """Centred inputs, the matrix whose product with k gives all that dm needs, and K o D_d for each input."""
        d = self.inputs.shape[1]
        centred = self.inputs - self.inputs.mean(axis=0)
        a = self._weights
        covariance = self.posterior.covariance(self.theta)
        squares = (centred.T[:, :, None] - centred.T[:, None, :]) ** 2
        products = squares * covariance / (self.hyperparameters.lengths**2)[:, None, None]
        columns = [a[:, None], a[:, None] * centred, a[:, None] * centred**2]
        columns += [self._factor.solve(products[i] @ a)[:, None] for i in range(d)]
        columns += [self._factor.solve(a)[:, None], self._factor.solve(np.ones_like(a))[:, None]]
        return centred, np.hstack(columns), products

    def _differentiate(self, chunk: Array, k: Array) -> tuple[Array, Array, Array, Array]:
        read = self.hyperparameters
        centred, columns, products = self._smooth
        d = chunk.shape[1]
        at = chunk - self.inputs.mean(axis=0)
        squared_lengths = read.lengths**2
        noise = read.noise_variance + self.jitter

        linear = k @ columns
        ka, kax, kaxx = linear[:, :1], linear[:, 1 : d + 1], linear[:, d + 1 : 2 * d + 1]
        dm = np.zeros((len(chunk), self.theta.size))
        dm[:, :d] = (at**2 * ka - 2.0 * at * kax + kaxx) / squared_lengths - linear[:, 2 * d + 1 : 3 * d + 1]
        dm[:, d] = 2.0 * noise * linear[:, 3 * d + 1]
        dm[:, d + 1] = -2.0 * read.noise_variance * linear[:, 3 * d + 1]
        if self.theta.size > d + 2:
            dm[:, d + 2] = 1.0 - linear[:, 3 * d + 2]

        v = k @ self._factor.inverse.T
        variance = self._variance(v)
        b = v @ self._factor.inverse
        h = k * b
        moments = h @ np.hstack([np.ones((len(centred), 1)), centred, centred**2])
        first = (at**2 * moments[:, :1] - 2.0 * at * moments[:, 1 : d + 1] + moments[:, d + 1 :]) / squared_lengths
        squared = np.einsum("bn,bn->b", b, b)
        dv = np.zeros_like(dm)
        for i in range(d):
            dv[:, i] = np.einsum("bn,bn->b", b @ products[i], b) - 2.0 * first[:, i]
        dv[:, d] = 2.0 * variance - 2.0 * noise * squared
        dv[:, d + 1] = 2.0 * read.noise_variance * squared
        return linear[:, 0] + read.mean, variance, dm, dv


def condition(
    inputs: Array,
    outputs: Array,
    theta: Array,
    prior: Hyperprior,
    mean: str = "zero",
    covariance: Array | None = None,
) -> MarginalGP:
    """Return the model at a given theta, without a search.

    Parameters
    ----------
    inputs, outputs : (N, D) and (N,) float arrays
        Standardised.
    theta : (P,) float array
        Hyperparameters.
    prior : Hyperprior
        For the Laplace approximation.
    mean : str
        ``zero`` or ``constant``.
    covariance : (P, P) float array, optional
        S, instead of the Laplace approximation.

    Raises
    ------
    ValueError
        When a shape does not fit or a value is not finite.
    """
    return MarginalGP(LogPosterior(inputs, outputs, prior, mean), theta, covariance)


def fit(
    inputs: Array,
    outputs: Array,
    prior: Hyperprior,
    mean: str = "zero",
    *,
    generator: np.random.Generator,
    starts: int = 8,
    warm_starts: Sequence[Array] = (),
) -> MarginalGP:
    """Return the model at the MAP of its hyperparameters.

    Parameters
    ----------
    inputs, outputs : (N, D) and (N,) float arrays
        Standardised.
    prior : Hyperprior
        Counted once.
    mean : str
        ``zero`` or ``constant``.
    generator : Generator
        Draws the starts.
    starts : int
        Draws from the hyperprior, beside its mean and the warm starts.
    warm_starts : sequence of (P,) float arrays
        Earlier maxima.

    Raises
    ------
    ValueError
        When a shape does not fit or a value is not finite.
    FactorisationError
        When rows nearly coincide and no start parts them.
    """
    posterior = LogPosterior(inputs, outputs, prior, mean)
    return MarginalGP(posterior, find_map(posterior, generator, starts, warm_starts).theta)
