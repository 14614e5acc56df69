"""The Laplace approximation: p(theta | D) ~ N(theta_MAP, S), with S^-1 minus the Hessian of the log posterior."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from stages.science.gp.hyperprior import Hyperprior
from stages.science.gp.kernel import Array

ROUNDING = 1e-12
"""Eigenvalues of a Hessian below this share of the largest are rounding."""

TOLERANCE = 1e-8
"""Share of its largest entry by which a given covariance may miss symmetry or have a negative eigenvalue."""


@dataclass(frozen=True)
class Laplace:
    """A Gaussian of covariance S, (P, P), around the maximum; `repair` says what was done to S, empty for nothing."""

    covariance: Array
    repair: str

    @cached_property
    def root(self) -> Array:
        """A (P, P) matrix R with S = R R'; a `ValueError` says that a given S has a negative eigenvalue."""
        variances, axes = np.linalg.eigh(self.covariance)
        if variances[0] < -TOLERANCE * np.abs(variances).max():
            raise ValueError(f"covariance: expected positive semi-definite, got smallest eigenvalue {variances[0]:.3g}")
        return axes * np.sqrt(np.maximum(variances, 0.0))


def approximate(hessian: Array, prior: Hyperprior) -> Laplace:
    """Return the Laplace approximation from the (P, P) Hessian of the log posterior, at its maximum or elsewhere.

    Where minus the Hessian is not positive definite, the posterior has no peak along some eigenvectors. Those
    directions get the hyperprior's precision: what is known there without data. All others stay as they are.
    """
    precision = -0.5 * (hessian + hessian.T)
    curvature, axes = np.linalg.eigh(precision)
    flat = curvature <= ROUNDING * float(np.abs(curvature).max())
    repair = ""
    if flat.any():
        covariance = (axes / np.where(flat, prior.precision @ axes**2, curvature)) @ axes.T
        repair = f"indefinite Hessian: hyperprior's precision along {int(flat.sum())} of {flat.size} directions"
    else:
        covariance = scipy.linalg.cho_solve(scipy.linalg.cho_factor(precision), np.eye(len(precision)))
    return Laplace(0.5 * (covariance + covariance.T), repair)


def accept(covariance: Array, size: int) -> Laplace:
    """Return a given covariance as it is; a `ValueError` says that it is not (P, P), finite and symmetric."""
    given = np.array(covariance, dtype=float)
    if given.shape != (size, size):
        raise ValueError(f"covariance: expected shape ({size}, {size}), got {given.shape}")
    largest = float(np.abs(given).max())
    if not np.isfinite(largest) or np.abs(given - given.T).max() > TOLERANCE * largest:
        raise ValueError(f"covariance: expected a finite symmetric matrix, got {given.tolist()}")
    return Laplace(0.5 * (given + given.T), "")
