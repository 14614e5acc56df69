"""The Laplace approximation: p(theta | D) ~ N(theta_MAP, S), with S^-1 minus the Hessian of the log posterior."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from stages.gp.hyperprior import Hyperprior

Array = NDArray[np.float64]

ROUNDING = 1e-12
"""Eigenvalues below this share of the largest are rounding."""


@dataclass(frozen=True)
class Laplace:
    """A Gaussian around the maximum.

    Parameters
    ----------
    covariance : (P, P) float array
        S.
    min_eigenvalue : float
        Smallest eigenvalue of minus the Hessian, before any repair; NaN when S was given.
    repair : str
        What was done when that was not positive; empty when nothing was.
    """

    covariance: Array
    min_eigenvalue: float
    repair: str

    @cached_property
    def root(self) -> Array:
        """A (P, P) matrix R with S = R R'."""
        variances, axes = np.linalg.eigh(self.covariance)
        return axes * np.sqrt(np.maximum(variances, 0.0))


def approximate(hessian: Array, prior: Hyperprior) -> Laplace:
    """Return the Laplace approximation from the Hessian of the log posterior.

    Where minus the Hessian is not positive definite, the posterior has no peak along some eigenvectors. Those
    directions get the hyperprior's precision: what is known there without data. All others stay as they are.

    Parameters
    ----------
    hessian : (P, P) float array
        Of the log posterior, at its maximum or elsewhere.
    prior : Hyperprior
        For the repair.
    """
    curvature, axes = np.linalg.eigh(-0.5 * (hessian + hessian.T))
    smallest = float(curvature[0])
    flat = curvature <= ROUNDING * float(np.abs(curvature).max())
    repair = ""
    if flat.any():
        curvature = np.where(flat, prior.precision @ axes**2, curvature)
        count = int(flat.sum())
        repair = f"indefinite Hessian: hyperprior's precision along {count} of {flat.size} directions"
    return Laplace((axes / curvature) @ axes.T, smallest, repair)


def accept(covariance: Array, size: int) -> Laplace:
    """Return a covariance that was given, as it is.

    Parameters
    ----------
    covariance : (P, P) float array
        S, symmetric, without negative eigenvalues.
    size : int
        P.

    Raises
    ------
    ValueError
        When it is none of that.
    """
    given = np.array(covariance, dtype=float)
    if given.shape != (size, size):
        raise ValueError(f"covariance: expected shape ({size}, {size}), got {given.shape}")
    largest = float(np.abs(given).max())
    if not np.isfinite(largest) or np.abs(given - given.T).max() > 1e-8 * largest:
        raise ValueError(f"covariance: expected a finite symmetric matrix, got {given.tolist()}")
    smallest = float(np.linalg.eigvalsh(given)[0])
    if smallest < -1e-8 * largest:
        raise ValueError(f"covariance: expected no negative eigenvalue, got {smallest:.3g}")
    return Laplace(0.5 * (given + given.T), np.nan, "")
