"""The marginal GP around a sparse one: what uncertain hyperparameters add to predictions that stand on many data.

A `SparsePosterior`, pseudo-inputs and theta flow in; predictions, their derivatives by theta and the utilities of many
points flow out. The pseudo-inputs are held: they say where the model is fine, not what the muscle is like. In the terms
of `sparse`, with K_d = K o D_d the slope of a covariance by the logarithm of length d (D_d: squared differences of
input d in units of its length), W_d = L^-1 K_d L^-T, P_d = L^-1 (K_mn)_d and lam_d = diag(V' W_d V - 2 V' P_d)::

    S_d = W_d + P_d Lam^-1 V' + V Lam^-1 P_d' - V Lam^-1 lam_d Lam^-1 V'       L^-1 d(K_mm + K_mn Lam^-1 K_nm) L^-T
    c_d = B^-1 (P_d Lam^-1 r - V Lam^-1 lam_d Lam^-1 r - S_d beta)             slope of B^-1 V Lam^-1 r, whitened
    Q_d = W_d - B^-1 S_d B^-1

A point x* with k = k_m(x*), v = L^-1 k, u = L^-T (v - B^-1 v) and w = L^-T beta then has::

    dm/dlog l_d = w' (k o D_d) + c_d' v        dV/dlog l_d = -2 u' (k o D_d) + v' Q_d v
    dm/dlog sn  = c_s' v                       dV/dlog sn  = 2 sn^2 |Lam^-1 V' B^-1 v|^2
    dm/dlog sf  = -dm/dlog sn                  dV/dlog sf  = 2 V - dV/dlog sn

with c_s = -2 sn^2 B^-1 V Lam^-1 a, and dm/dmean = 1 - v' B^-1 V Lam^-1 1. The last line says that only sf^2 / sn^2
matters to the mean. S, the Laplace approximation, comes from central differences of the analytic gradient.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stages.science.gp.cross import choose_cross
from stages.science.gp.hyperprior import Hyperprior
from stages.science.gp.kernel import Array, covariance_among, squared_differences
from stages.science.gp.marginal_model import MarginalModel
from stages.science.gp.prediction import Moments, limit_chunk
from stages.science.gp.sparse import SparsePosterior, blocks, replace_lengths
from stages.science.gp.sparse_model import SparseGP

STEP = 1e-4
"""Of the differences: their error, the gradient's third derivative x STEP^2 / 6, is then about that of rounding."""


class SparseMarginalGP(MarginalModel):
    """A sparse GP at given pseudo-inputs and hyperparameters, with the Laplace approximation of the latter.

    Takes and refuses what `SparseGP` does, a posterior without a hyperprior too; S, (P, P), may be given instead of the
    Laplace approximation at theta.
    """

    def __init__(self, posterior: SparsePosterior, pseudo: Array, theta: Array, covariance: Array | None = None):
        if posterior.prior is None:
            raise ValueError("expected a hyperprior, without which hyperparameters have no distribution")
        self.posterior, self.sparse = posterior, SparseGP(posterior, pseudo, theta)
        super().__init__(self.sparse.theta, self.sparse.hyperparameters, posterior.prior, covariance)

    @property
    def pseudo(self) -> Array:
        """(M, D) pseudo-inputs."""
        return self.sparse.pseudo

    @property
    def log_posterior(self) -> float:
        """At pseudo-inputs and theta (nats)."""
        return self.sparse.log_posterior

    def _curvature(self) -> Array:
        """Return the Hessian with pseudo-inputs held."""
        steps = STEP * np.eye(self.theta.size)
        above, below = (
            np.array([self.posterior.derivatives(self.pseudo, self.theta + sign * each).theta for each in steps])
            for sign in (1.0, -1.0)
        )
        return np.asarray((above - below) / (2.0 * STEP))

    @property
    def _jitter_repair(self) -> str:
        return self.sparse.repair

    @cached_property
    def slopes(self) -> Slopes:
        """What the slopes of all points share."""
        return _find_slopes(self.posterior, self.pseudo, self.theta)

    def _predictor(self, size: int) -> SparsePredictor:
        return SparsePredictor(self, size)

    def _chunk_size(self, memory_mb: float) -> int:
        m, d = self.pseudo.shape
        return limit_chunk(m * (8 + d) + 12 * (d + 3), memory_mb)


@dataclass(frozen=True)
class Slopes:
    """What the slopes of all points share: Q_d, (D, M, M); rows of M numbers; 2 sn^2 B^-1 V Lam^-2 V' B^-1, (M, M).

    The rows are c_d of each length, c_s and, with a constant mean, -B^-1 V Lam^-1 1.
    """

    quadratic: Array
    linear: Array
    noise: Array


def _find_slopes(posterior: SparsePosterior, pseudo: Array, theta: Array) -> Slopes:
    """Pass over the data once for each length."""
    with np.errstate(all="ignore"):
        at = posterior.condition(pseudo, theta)
    read, whiten, inner = at.read, at.factor.inverse, at.inner
    m, d = at.scaled.shape
    columns = (posterior.inputs - posterior.centre).T / read.lengths[:, None]
    squares = squared_differences(at.scaled)
    among = covariance_among(squares, replace_lengths(read))
    own_slopes = np.stack([whiten @ (among * square) @ whiten.T for square in squares])
    floor = m * np.finfo(float).eps * read.signal_variance

    total, linear = own_slopes.copy(), np.zeros((d, m))
    gram, weighted, ones = np.zeros((m, m)), np.zeros(m), np.zeros(m)
    for block in blocks(len(at.lam)):
        v, k, lam, residual = at.v[:, block], at.k[:, block], at.lam[block], at.residual[block]
        scaled = v / lam
        free = read.signal_variance - np.einsum("mn,mn->n", v, v) > floor
        for i in range(d):
            p = whiten @ (k * (at.scaled[:, i, None] - columns[i, block]) ** 2)
            slope = np.where(free, np.einsum("mn,mn->n", v, own_slopes[i] @ v - 2.0 * p), 0.0)
            both = p @ scaled.T
            total[i] += both + both.T - (scaled * slope) @ scaled.T
            linear[i] += p @ (residual / lam) - scaled @ (slope * residual / lam)
        gram += scaled @ scaled.T
        weighted += scaled @ ((residual - at.beta @ v) / lam)
        ones += scaled.sum(axis=1)

    def solve_both_sides(matrix: Array) -> Array:
        return inner.solve(inner.solve(matrix).T)

    noise = 2.0 * read.noise_variance
    rows = [inner.solve(each - s @ at.beta) for each, s in zip(linear, total, strict=True)]
    rows.append(-noise * inner.solve(weighted))
    if posterior.mean == "constant":
        rows.append(-inner.solve(ones))
    quadratic = np.stack([w - solve_both_sides(s) for w, s in zip(own_slopes, total, strict=True)])
    return Slopes(quadratic, np.stack(rows), noise * solve_both_sides(gram))


class SparsePredictor:
    """Predicts a model's chunks of at most `size` points, with working memory of its own."""

    def __init__(self, model: SparseMarginalGP, size: int):
        self._model, self._read = model, model.hyperparameters
        self._scaled, self._whiten = model.sparse.scaled, model.sparse.whiten
        m, d = self._scaled.shape
        self.floor = m * float(np.finfo(float).eps) * self._read.signal_variance
        self._k, self._v, self._s, self._u, self._spare = np.empty((5, m, size))
        self._products = np.empty((d, m, size))

    def predict_mean(self, points: Array) -> Array:
        """Return the mean, (B,)."""
        return self._model.sparse.predict_mean(points)

    def predict(self, points: Array) -> tuple[Array, Array]:
        """Return mean and variance, (B,) each."""
        return self._model.sparse.predict(points)

    def differentiate(self, points: Array) -> Moments:
        """Return mean and variance with their derivatives."""
        sparse, slopes, read, count = self._model.sparse, self._model.slopes, self._read, len(points)
        d = read.lengths.size
        k, v, s, u, spare = (each[:, :count] for each in (self._k, self._v, self._s, self._u, self._spare))
        columns = ((points - sparse.centre) / read.lengths).T
        choose_cross(self._scaled, columns, read.signal_variance, read.noise_variance).covariance(slice(None), k)
        np.matmul(self._whiten, k, out=v)
        np.matmul(sparse.inner, v, out=spare)
        explained = np.einsum("mb,mb->b", v, v)
        variance = np.maximum(read.signal_variance - explained, self.floor) + np.einsum("mb,mb->b", spare, spare)
        np.subtract(v, np.matmul(sparse.inner.T, spare, out=s), out=s)
        np.matmul(self._whiten.T, s, out=u)
        products = np.matmul(slopes.quadratic, v, out=self._products[:, :, :count])

        dm, dv = np.zeros((2, self._model.theta.size, count))
        linear = slopes.linear @ v
        for i in range(d):
            np.subtract(self._scaled[:, i, None], columns[i], out=spare)
            np.multiply(spare, spare, out=spare)
            np.multiply(spare, k, out=spare)
            dm[i] = sparse.weights @ spare + linear[i]
            dv[i] = np.einsum("mb,mb->b", v, products[i]) - 2.0 * np.einsum("mb,mb->b", u, spare)
        dm[d], dm[d + 1] = -linear[d], linear[d]
        dm[d + 2 :] = 1.0 + linear[d + 1 :]
        dv[d + 1] = np.einsum("mb,mb->b", v, np.matmul(slopes.noise, v, out=spare))
        dv[d] = 2.0 * variance - dv[d + 1]
        return Moments(sparse.beta @ v + read.mean, variance, dm, dv)


def condition_sparse(
    inputs: Array, outputs: Array, pseudo: Array, theta: Array, prior: Hyperprior, mean: str = "zero"
) -> SparseMarginalGP:
    """Return the model at given pseudo-inputs and theta, without a search."""
    return SparseMarginalGP(SparsePosterior(inputs, outputs, prior, mean), pseudo, theta)
