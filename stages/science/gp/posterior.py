"""The log posterior of the hyperparameters, with gradient and Hessian in closed form.

Data and hyperprior flow in once; a theta flows in, value, gradient and Hessian flow out. With C = L L',
z = L^-1 (y - m), a = C^-1 (y - m), W_i = L^-1 (dC/dtheta_i) L^-T and G = a a' - C^-1:

    d/di    = 1/2 <G, dC_i>
    d2/didj = -(W_i z)'(W_j z) + 1/2 <W_i, W_j> + 1/2 <G, d2C_ij>

after Rasmussen and Williams (2006), 5.4; the hyperprior is counted once.
"""

import numpy as np
import scipy
from numpy.typing import NDArray

from stages.science.gp.factor import Factor, FactorisationError, factorise
from stages.science.gp.hyperprior import Hyperprior
from stages.science.gp.kernel import (
    Array,
    Hyperparameters,
    count_hyperparameters,
    covariance_among,
    squared_differences,
)

LARGEST_LOG = 50.0
LARGEST_VALUE = 1e50


class LogPosterior:
    """log N(y | m, K + sn^2 I) + log p(theta) as a function of theta, for standardised data.

    One thread at a time may ask for derivatives: they share working memory of (2 D + 2) N^2 numbers. A `ValueError`
    tells a shape that does not fit (N, D) inputs, (N,) outputs and the hyperprior, or a value that is not finite.
    """

    def __init__(self, inputs: Array, outputs: Array, prior: Hyperprior, mean: str = "zero"):
        self.inputs, self.outputs = check_data(inputs, outputs)
        check_prior(prior, self.inputs.shape[1], mean)
        self.prior = prior
        self.mean = mean
        self._squares = squared_differences(self.inputs)
        self._work: Array | None = None

    def read(self, theta: Array) -> Hyperparameters:
        """Return theta, read; raises as `read_theta`."""
        return read_theta(theta, self.inputs.shape[1], self.prior.mean.size)

    def covariance(self, theta: Array) -> Array:
        """Return K, (N, N), without noise."""
        with np.errstate(over="ignore", under="ignore"):
            return covariance_among(self._squares, self.read(theta))

    def factor(self, theta: Array) -> Factor:
        """Return the factor of K + sn^2 I; a `FactorisationError` says which rows neither noise nor jitter parts."""
        return self._factor(self.read(theta))

    def residual(self, theta: Array) -> Array:
        """Return y - m, (N,)."""
        return self.outputs - self.read(theta).mean

    def value(self, theta: Array) -> float:
        """Return the log posterior (nats)."""
        return self.log_likelihood(theta) + self.prior.log_density(theta)

    def log_likelihood(self, theta: Array) -> float:
        """Return the log marginal likelihood (nats)."""
        read = self.read(theta)
        factor = self._factor(read)
        return _log_likelihood(factor, factor.whiten(self.outputs - read.mean))

    def derivatives(self, theta: Array) -> tuple[float, Array, Array]:
        """Return value, gradient (P,) and Hessian (P, P) of the log posterior at theta (P,)."""
        value, gradient, hessian = self.likelihood_derivatives(theta)
        hessian.flat[:: len(hessian) + 1] -= self.prior.precision
        return value + self.prior.log_density(theta), gradient + self.prior.gradient(theta), hessian

    def ascent(self, theta: Array) -> tuple[float, Array]:
        """Return value and gradient (P,) of the log posterior at theta (P,), much faster than with a Hessian.

        A `FactorisationError` tells what `likelihood_derivatives` tells.
        """
        read, d = self.read(theta), self.inputs.shape[1]
        with np.errstate(all="ignore"):
            covariance, factor, z, a, outer = self._weigh(read)
            weighed = outer * covariance
            lengths = 0.5 * (self._squares.reshape(d, -1) @ weighed.ravel()) / read.lengths**2
            rest = [weighed.sum(), read.noise_variance * np.trace(outer), a.sum()][: self.prior.mean.size - d]
            value = _log_likelihood(factor, z) + self.prior.log_density(theta)
            gradient = np.append(lengths, rest) + self.prior.gradient(theta)
        if not (np.isfinite(value) and np.isfinite(gradient).all()):
            raise FactorisationError(f"the log posterior is not finite at theta = {np.asarray(theta).tolist()}")
        return value, gradient

    def likelihood_derivatives(self, theta: Array) -> tuple[float, Array, Array]:
        """Return value, gradient (P,) and Hessian (P, P) of the log marginal likelihood at theta (P,).

        A `FactorisationError` tells rows that nearly coincide, or derivatives out of floating-point range.
        """
        with np.errstate(all="ignore"):
            found = self._differentiate(self.read(theta))
        if not all(np.isfinite(each).all() for each in found):
            raise FactorisationError(f"the derivatives of the log posterior are not finite at theta = {theta.tolist()}")
        return found

    def _factor(self, read: Hyperparameters) -> Factor:
        with np.errstate(over="ignore", under="ignore"):
            return self._factorise(covariance_among(self._squares, read), read)

    def _factorise(self, covariance: Array, read: Hyperparameters) -> Factor:
        noisy = covariance.copy()
        noisy.flat[:: len(noisy) + 1] += read.noise_variance
        return factorise(noisy, self.inputs / read.lengths)

    def _weigh(self, read: Hyperparameters) -> tuple[Array, Factor, Array, Array, Array]:
        """Return K, the factor of C, z, a and G."""
        covariance = covariance_among(self._squares, read)
        factor = self._factorise(covariance, read)
        z = factor.inverse @ (self.outputs - read.mean)
        a = factor.inverse.T @ z
        outer = np.outer(a, a)
        outer -= factor.inverse.T @ factor.inverse
        return covariance, factor, z, a, outer

    def _differentiate(self, read: Hyperparameters) -> tuple[float, Array, Array]:
        n, d = self.inputs.shape
        covariance, factor, z, _, outer = self._weigh(read)
        inverse = factor.inverse
        if self._work is None:
            self._work = np.empty((d + 2, n, n))
        whitened, slopes = self._work, self._work[:d]
        flat, squares = whitened.reshape(d + 2, -1), self._squares.reshape(d, -1)
        np.multiply(self._squares, covariance, out=slopes)
        curvature = self._curve(read, outer, flat[:d], squares, float(np.vdot(outer, covariance)))
        for slope, length in zip(slopes, read.lengths, strict=True):
            half = scipy.linalg.blas.dtrmm(1.0 / length**2, inverse.T, slope.T, trans_a=1)
            slope[:] = scipy.linalg.blas.dtrmm(1.0, inverse.T, half, side=1)
        np.matmul(inverse, inverse.T, out=whitened[d + 1])
        np.multiply(whitened[d + 1], -2.0 * (read.noise_variance + factor.jitter), out=whitened[d])
        whitened[d].flat[:: n + 1] += 2.0
        whitened[d + 1] *= 2.0 * read.noise_variance

        pulled = whitened @ z
        gradient = 0.5 * (pulled @ z - np.trace(whitened, axis1=1, axis2=2))
        hessian = 0.5 * (flat @ flat.T + curvature) - pulled @ pulled.T
        if self.mean == "constant":
            ones = inverse.sum(axis=1)
            cross = -pulled @ ones
            bottom = np.append(cross, -ones @ ones)
            gradient, hessian = np.append(gradient, ones @ z), np.vstack([np.column_stack([hessian, cross]), bottom])
        return _log_likelihood(factor, z), gradient, hessian

    def _curve(self, read: Hyperparameters, g: Array, slopes: Array, squares: Array, total: float) -> Array:
        """Return <G, d2C_ij>, (D + 2, D + 2), from (D, N^2) squares and the same times K, and <G, K>."""
        d, squared_lengths = len(squares), read.lengths**2
        first = slopes @ g.ravel() / squared_lengths
        curvature = np.zeros((d + 2, d + 2))
        curvature[:d, :d] = (slopes * g.ravel()) @ squares.T / np.outer(squared_lengths, squared_lengths)
        curvature.flat[: d * (d + 2) : d + 3] -= 2.0 * first
        curvature[:d, d] = curvature[d, :d] = 2.0 * first
        curvature[d, d] = 4.0 * total
        curvature[d + 1, d + 1] = 4.0 * read.noise_variance * np.trace(g)
        return curvature


def _log_likelihood(factor: Factor, z: Array) -> float:
    with np.errstate(over="ignore"):
        return float(-0.5 * (z @ z + factor.log_determinant + z.size * np.log(2 * np.pi)))


def read_theta(theta: Array, dimensions: int, size: int) -> Hyperparameters:
    """Return a hyperparameter vector of `size` entries for D inputs, read; a `ValueError` tells another shape.

    A `FactorisationError` tells that it is out of a range that keeps all that follows from it finite.
    """
    theta = np.asarray(theta, dtype=float)
    if theta.shape != (size,):
        raise ValueError(f"theta: expected {size} entries, got shape {theta.shape}")
    logs = theta[: dimensions + 2]
    if not (np.abs(logs) <= LARGEST_LOG).all():
        raise FactorisationError(
            f"theta: expected logarithms between -{LARGEST_LOG:g} and {LARGEST_LOG:g}, got {logs.tolist()}"
        )
    if not (np.abs(theta[dimensions + 2 :]) <= LARGEST_VALUE).all():
        raise FactorisationError(f"theta: expected a constant mean within {LARGEST_VALUE:g}, got {theta[-1]}")
    return Hyperparameters.read(theta, dimensions)


def check_prior(prior: Hyperprior, dimensions: int, mean: str) -> None:
    """Refuse, by a `ValueError`, a hyperprior of another size than the mean and D inputs need."""
    expected = count_hyperparameters(dimensions, mean)
    if prior.mean.size != expected:
        raise ValueError(
            f"hyperprior: expected {expected} entries for {dimensions} inputs and a {mean} mean, got {prior.mean.size}"
        )


def check_points(points: Array, dimensions: int, name: str = "points") -> Array:
    """Return (B, D) points as a float64 array; a `ValueError` tells another shape or what is not finite."""
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or points.shape[1] != dimensions:
        raise ValueError(f"{name}: expected shape (B, {dimensions}), got {points.shape}")
    row = find_bad_row(np.isfinite(points))
    if row is not None:
        raise ValueError(f"{name}: expected finite values, got {points[row].tolist()} in row {row}")
    return points


def check_data(inputs: Array, outputs: Array) -> tuple[Array, Array]:
    """Return (N, D) inputs and (N,) outputs as float64 arrays.

    A `ValueError` tells other shapes, N or D of 0, and a value that is not finite or absurdly large.
    """
    x, y = np.asarray(inputs, dtype=float), np.asarray(outputs, dtype=float)
    if x.ndim != 2 or y.shape != x.shape[:1] or not x.size:
        raise ValueError(f"expected inputs (N, D) and outputs (N,), got shapes {x.shape} and {y.shape}")
    for name, values in (("inputs", x), ("outputs", y)):
        for good, expected, remedy in (
            (np.isfinite(values), f"finite {name}", ""),
            (np.abs(values) <= LARGEST_VALUE, f"{name} within {LARGEST_VALUE:g}", "; standardise them"),
        ):
            row = find_bad_row(good)
            if row is not None:
                raise ValueError(f"expected {expected}, got {values[row].tolist()} in row {row}{remedy}")
    return x, y


def find_bad_row(good: NDArray[np.bool_]) -> int | None:
    """Return the first row with an entry that is not good, if there is one."""
    if good.all():
        return None
    return int(np.argmin(good.reshape(len(good), -1).all(axis=1)))
