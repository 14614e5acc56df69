"""The log posterior of the hyperparameters, with gradient and Hessian in closed form.

Data and hyperprior flow in once; a theta flows in, value, gradient and Hessian flow out. With C = L L',
z = L^-1 (y - m), a = C^-1 (y - m), W_i = L^-1 (dC/dtheta_i) L^-T and G = a a' - C^-1:

    d/di    = 1/2 <G, dC_i>
    d2/didj = -(W_i z)'(W_j z) + 1/2 <W_i, W_j> + 1/2 <G, d2C_ij>

after Rasmussen and Williams (2006), 5.4; the hyperprior is counted once.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stages.gp.factor import Factor, factorise
from stages.gp.hyperprior import Hyperprior
from stages.gp.kernel import Hyperparameters, count_hyperparameters, squared_differences

Array = NDArray[np.float64]


class LogPosterior:
    """log N(y | m, K + sn^2 I) + log p(theta) as a function of theta.

    Parameters
    ----------
    inputs : (N, D) float array
        Standardised.
    outputs : (N,) float array
        Standardised.
    prior : Hyperprior
        Of D + 2 hyperparameters, D + 3 with a constant mean.
    mean : str
        ``zero`` or ``constant``.

    Raises
    ------
    ValueError
        When a shape does not fit or a value is not finite.
    """

    def __init__(self, inputs: Array, outputs: Array, prior: Hyperprior, mean: str = "zero"):
        self.inputs, self.outputs = check_data(inputs, outputs)
        expected = count_hyperparameters(self.inputs.shape[1], mean)
        if prior.mean.size != expected:
            raise ValueError(
                f"hyperprior: expected {expected} entries for {self.inputs.shape[1]} inputs and a {mean} mean, "
                f"got {prior.mean.size}"
            )
        self.prior = prior
        self.mean = mean
        self._squares = squared_differences(self.inputs)

    def covariance(self, theta: Array) -> Array:
        """Return K, (N, N), without noise."""
        read = Hyperparameters.read(theta, self.inputs.shape[1])
        exponent = np.tensordot(-0.5 / read.lengths**2, self._squares, axes=1)
        covariance: Array = read.signal_variance * np.exp(exponent)
        return covariance

    def factor(self, theta: Array) -> Factor:
        """Return the factor of K + sn^2 I.

        Raises
        ------
        FactorisationError
            When rows nearly coincide and neither noise nor jitter parts them.
        """
        noise = np.exp(2 * theta[self.inputs.shape[1] + 1])
        return factorise(self.covariance(theta) + noise * np.eye(len(self.inputs)), self.inputs)

    def residual(self, theta: Array) -> Array:
        """Return y - m, (N,)."""
        return self.outputs - Hyperparameters.read(theta, self.inputs.shape[1]).mean

    def value(self, theta: Array) -> float:
        """Return the log posterior (nats)."""
        return self.log_likelihood(theta) + self.prior.log_density(theta)

    def log_likelihood(self, theta: Array) -> float:
        """Return the log marginal likelihood (nats)."""
        return self._log_likelihood(self.factor(theta), self.residual(theta))

    @staticmethod
    def _log_likelihood(factor: Factor, residual: Array) -> float:
        z = factor.whiten(residual)
        return float(-0.5 * (z @ z + factor.log_determinant + z.size * np.log(2 * np.pi)))

    def derivatives(self, theta: Array) -> tuple[float, Array, Array]:
        """Return value, gradient (P,) and Hessian (P, P) of the log posterior at theta (P,)."""
        value, gradient, hessian = self.likelihood_derivatives(theta)
        return (
            value + self.prior.log_density(theta),
            gradient + self.prior.gradient(theta),
            hessian - np.diag(self.prior.precision),
        )

    def likelihood_derivatives(self, theta: Array) -> tuple[float, Array, Array]:
        """Return value, gradient (P,) and Hessian (P, P) of the log marginal likelihood at theta (P,)."""
        n, d = self.inputs.shape
        read = Hyperparameters.read(theta, d)
        covariance = self.covariance(theta)
        factor = factorise(covariance + read.noise_variance * np.eye(n), self.inputs)
        residual = self.residual(theta)
        inverse = factor.inverse
        z = inverse @ residual
        a = inverse.T @ z

        scaled = self._squares / (read.lengths**2)[:, None, None]
        products = scaled * covariance
        whitened = np.empty((d + 2, n, n))
        np.matmul(inverse @ products, inverse.T, out=whitened[:d])
        spread = inverse @ inverse.T
        whitened[d] = 2.0 * (np.eye(n) - (read.noise_variance + factor.jitter) * spread)
        whitened[d + 1] = 2.0 * read.noise_variance * spread

        flat = whitened.reshape(d + 2, -1)
        pulled = whitened @ z
        gradient = 0.5 * (pulled @ z - np.trace(whitened, axis1=1, axis2=2))
        hessian = (
            0.5 * (flat @ flat.T)
            - pulled @ pulled.T
            + 0.5 * self._curvature(read, covariance, scaled, np.outer(a, a) - inverse.T @ inverse)
        )
        if self.mean == "constant":
            gradient, hessian = _append_mean(gradient, hessian, inverse.sum(axis=1), pulled, z)
        return self._log_likelihood(factor, residual), gradient, hessian

    @staticmethod
    def _curvature(read: Hyperparameters, covariance: Array, scaled: Array, g: Array) -> Array:
        d = len(scaled)
        weights = (g * covariance).ravel()
        flat = scaled.reshape(d, -1)
        first = flat @ weights
        curvature = np.zeros((d + 2, d + 2))
        curvature[:d, :d] = (flat * weights) @ flat.T - 2.0 * np.diag(first)
        curvature[:d, d] = curvature[d, :d] = 2.0 * first
        curvature[d, d] = 4.0 * weights.sum()
        curvature[d + 1, d + 1] = 4.0 * read.noise_variance * np.trace(g)
        return curvature


def _append_mean(gradient: Array, hessian: Array, ones: Array, pulled: Array, z: Array) -> tuple[Array, Array]:
    cross = -pulled @ ones
    bottom = np.append(cross, -ones @ ones)
    return np.append(gradient, ones @ z), np.vstack([np.column_stack([hessian, cross]), bottom])


def check_data(inputs: Array, outputs: Array) -> tuple[Array, Array]:
    """Return data as float64 arrays.

    Raises
    ------
    ValueError
        When the shapes are not (N, D) and (N,) with N and D at least 1, or a value is not finite.
    """
    x, y = np.asarray(inputs, dtype=float), np.asarray(outputs, dtype=float)
    if x.ndim != 2 or y.shape != x.shape[:1] or not x.size:
        raise ValueError(f"expected inputs (N, D) and outputs (N,), got shapes {x.shape} and {y.shape}")
    for name, values in (("inputs", x), ("outputs", y)):
        bad = ~np.isfinite(values if values.ndim == 1 else values.sum(axis=1))
        if bad.any():
            raise ValueError(f"expected finite {name}, got {values[bad][0]} in row {int(np.argmax(bad))}")
    return x, y
