"""A sparse GP through pseudo-inputs, and the log marginal likelihood of many data in O(N M^2).

Data flow in once; (M, D) pseudo-inputs and theta flow in, value and gradient, or what a model needs, flow out.
After Snelson and Ghahramani (2006), who call it SPGP, others FITC. With Q = K_nm K_mm^-1 K_mn the data's covariance is
C = Q + Lam, Lam = diag(K_nn - Q) + sn^2 I. With K_mm = L L', V = L^-1 K_mn, r = y - m, B = I + V Lam^-1 V' and
beta = B^-1 V Lam^-1 r, so that a = C^-1 r = Lam^-1 (r - V' beta) and V a = beta:

    log p(y)  = -1/2 (log|B| + log|Lam| + r' Lam^-1 r - (V Lam^-1 r)' beta + N log 2 pi)

With G = a a' - C^-1, g its diagonal and H = G - diag(g), so that V C^-1 = B^-1 V Lam^-1:

    V H       = beta a' - B^-1 V Lam^-1 - V diag(g)   T = L^-T V H
    V H V'    = beta beta' - I + B^-1 - V diag(g) V'  R = L^-T V H V' L^-1
    d log p   = <T, dK_mn> - 1/2 <R, dK_mm> + 1/2 sum(g) (d sf^2 + d sn^2)

K_mm always has `RELATIVE_JITTER` sf^2 on its diagonal: a jitter that came and went would make steps in the likelihood.
`factorise` adds more if that is too little. K_nn - Q is held at its rounding error.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stages.science.gp.cross import Cross, choose_cross
from stages.science.gp.factor import Factor, FactorisationError, factorise
from stages.science.gp.hyperprior import Hyperprior
from stages.science.gp.kernel import (
    Array,
    Hyperparameters,
    count_hyperparameters,
    covariance_among,
    squared_differences,
)
from stages.science.gp.posterior import check_data, check_points, check_prior, read_theta

RELATIVE_JITTER = 1e-10
BLOCK = 2000
"""Data at a time: what is worked on then stays in the processor's cache."""


@dataclass(frozen=True)
class SparseSlopes:
    """The log density (nats) and its slopes by (M, D) pseudo-inputs and (P,) hyperparameters."""

    value: float
    pseudo: Array
    theta: Array


class SparsePosterior:
    """The log marginal likelihood of a sparse GP, plus a hyperprior's log density if there is one.

    Takes and refuses what `LogPosterior` does. One thread at a time may ask: all calls share working memory of 2 N M
    numbers.
    """

    def __init__(self, inputs: Array, outputs: Array, prior: Hyperprior | None = None, mean: str = "zero"):
        self.inputs, self.outputs = check_data(inputs, outputs)
        d = self.inputs.shape[1]
        self.size = count_hyperparameters(d, mean)
        if prior is not None:
            check_prior(prior, d, mean)
        self.prior, self.mean = prior, mean
        self.centre = self.inputs.mean(axis=0)
        self._columns = np.ascontiguousarray((self.inputs - self.centre).T)
        self._work = np.empty((2, 0, len(self.outputs)))

    def value(self, pseudo: Array, theta: Array) -> float:
        """Return the log density at (M, D) pseudo-inputs and theta (nats); raises like `condition`."""
        with np.errstate(all="ignore"):
            value = self.condition(pseudo, theta).log_likelihood
        return self._check_range(value if self.prior is None else value + self.prior.log_density(np.asarray(theta)))

    def derivatives(self, pseudo: Array, theta: Array) -> SparseSlopes:
        """Return the log density with its gradient at (M, D) pseudo-inputs and theta; raises like `condition`."""
        with np.errstate(all="ignore"):
            found = self._differentiate(self.condition(pseudo, theta))
        value, slope = found.value, found.theta
        if self.prior is not None:
            theta = np.asarray(theta, dtype=float)
            value, slope = value + self.prior.log_density(theta), slope + self.prior.gradient(theta)
        self._check_range(value + float(np.abs(found.pseudo).sum() + np.abs(slope).sum()))
        return SparseSlopes(value, found.pseudo, slope)

    def condition(self, pseudo: Array, theta: Array) -> Conditioned:
        """Return all that the likelihood, its gradient and predictions share.

        A `ValueError` tells a shape that does not fit or a pseudo-input that is not finite, a `FactorisationError` a
        theta out of range or a noise too low for a trustworthy result.
        """
        read = read_theta(theta, self.inputs.shape[1], self.size)
        pseudo = check_points(pseudo, self.inputs.shape[1], "pseudo-inputs")
        if not len(pseudo):
            raise ValueError("pseudo-inputs: expected at least 1, got none")
        m, n = len(pseudo), len(self.outputs)
        if self._work.shape[1] != m:
            self._work = np.empty((2, m, n))
        k, v = self._work
        scaled = (pseudo - self.centre) / read.lengths
        cross = choose_cross(scaled, self._columns / read.lengths[:, None], read.signal_variance, read.noise_variance)
        among = covariance_among(squared_differences(scaled), replace_lengths(read))
        among.flat[:: m + 1] += RELATIVE_JITTER * read.signal_variance
        factor = factorise(among, scaled)
        residual = self.outputs - read.mean
        floor = m * np.finfo(float).eps * read.signal_variance

        lam, b, projected = np.empty(n), np.eye(m), np.zeros(m)
        weighted = np.empty((m, min(n, BLOCK)))
        for block in blocks(n):
            own = v[:, block]
            np.matmul(factor.inverse, cross.covariance(block, k[:, block]), out=own)
            here = read.signal_variance - np.einsum("mn,mn->n", own, own)
            lam[block] = np.maximum(here, floor, out=here) + read.noise_variance
            scale = 1.0 / np.sqrt(lam[block])
            each = np.multiply(own, scale, out=weighted[:, : scale.size])
            b += each @ each.T
            projected += each @ (scale * residual[block])
        inner = factorise(b, scaled)
        if inner.jitter:
            raise FactorisationError(
                f"noise variance {read.noise_variance:.3g}: too low for {n} data beside a signal variance of "
                f"{read.signal_variance:.3g}"
            )
        return Conditioned(read, scaled, cross, factor, inner, k, v, lam, residual, projected)

    def _differentiate(self, at: Conditioned) -> SparseSlopes:
        (m, n), read, k, v = at.v.shape, at.read, at.k, at.v
        d = read.lengths.size
        precision = at.inner.inverse.T @ at.inner.inverse
        upper = np.ascontiguousarray(at.factor.inverse.T)
        beta = at.beta
        leading = np.column_stack([upper, upper @ beta])
        vgv, first, second, sums = np.zeros((m, m)), np.zeros((m, d)), np.zeros(d), np.zeros(3)
        rows, spare = np.empty((m + 1, min(n, BLOCK))), np.empty((m, min(n, BLOCK)))
        for block in blocks(n):
            own, lam = v[:, block], at.lam[block]
            s, a, product = rows[:m, : lam.size], rows[m, : lam.size], spare[:, : lam.size]
            np.matmul(precision, own, out=s)
            np.divide(at.residual[block] - beta @ own, lam, out=a)
            g = a * a - (1.0 - np.einsum("mn,mn->n", own, s) / lam) / lam
            s /= -lam
            np.multiply(own, g, out=product)
            vgv += product @ own.T
            s -= product
            np.matmul(leading, rows[:, : lam.size], out=product)
            product *= k[:, block]
            differences, squares, total = at.cross.slopes(block, product)
            first += differences
            second += squares
            sums += total, g.sum(), a.sum()

        vhv = np.outer(beta, beta) - np.eye(m) + precision - vgv
        squares_among = squared_differences(at.scaled)
        r = (upper @ vhv @ upper.T) * covariance_among(squares_among, replace_lengths(read))
        second -= 0.5 * np.tensordot(squares_among, r, axes=2)
        first -= at.scaled * r.sum(axis=1)[:, None] - r @ at.scaled
        log_signal = 2.0 * sums[0] - np.trace(vhv) + read.signal_variance * sums[1]
        theta = np.concatenate([second, [log_signal, read.noise_variance * sums[1]], sums[2:][: self.size - d - 2]])
        return SparseSlopes(at.log_likelihood, -first / read.lengths, theta)

    def _check_range(self, value: float) -> float:
        if not np.isfinite(value):
            raise FactorisationError("the likelihood of the sparse GP or its gradient is out of floating-point range")
        return value


@dataclass(frozen=True)
class Conditioned:
    """The likelihood's parts at theta and (M, D) pseudo-inputs, `scaled`: centred like the data, in units of lengths.

    `factor` is L of K_mm and `inner` that of B; k and v are K_mn and V, (M, N), in working memory that the next call
    overwrites; the (N,) lam and residual are the diagonal of Lam and r; projected, (M,), is V Lam^-1 r.
    """

    read: Hyperparameters
    scaled: Array
    cross: Cross
    factor: Factor
    inner: Factor
    k: Array
    v: Array
    lam: Array
    residual: Array
    projected: Array

    @cached_property
    def beta(self) -> Array:
        """B^-1 V Lam^-1 r, (M,)."""
        return self.inner.solve(self.projected)

    @cached_property
    def log_likelihood(self) -> float:
        """In nats."""
        z = self.inner.whiten(self.projected)
        quadratic = float(self.residual @ (self.residual / self.lam)) - float(z @ z)
        logs = self.inner.log_determinant + float(np.log(self.lam).sum()) + self.lam.size * np.log(2 * np.pi)
        return float(-0.5 * (quadratic + logs))


def blocks(count: int) -> Iterator[slice]:
    """Split rows into blocks of `BLOCK`."""
    for start in range(0, count, BLOCK):
        yield slice(start, min(start + BLOCK, count))


def replace_lengths(read: Hyperparameters) -> Hyperparameters:
    """Return hyperparameters for inputs in units of the lengths."""
    return Hyperparameters(np.ones_like(read.lengths), read.signal_variance, read.noise_variance, read.mean)
