"""The Laplace approximation: p(theta | D) ~ N(theta_MAP, S), with S^-1 minus the Hessian of the log posterior."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stages.gp.hyperprior import Hyperprior

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Laplace:
    """A Gaussian around the maximum.

    Parameters
    ----------
    covariance : (P, P) float array
        S.
    min_eigenvalue : float
        Smallest eigenvalue of minus the Hessian, before any repair.
    repair : str
        What was done when that was not positive; empty when nothing was.
    """

    covariance: Array
    min_eigenvalue: float
    repair: str


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
    rounding = 1e-12 * float(np.abs(curvature).max())
    flat = curvature <= rounding
    repair = ""
    if flat.any():
        curvature = np.where(flat, prior.precision @ axes**2, curvature)
        count = int(flat.sum())
        repair = f"indefinite Hessian: hyperprior's precision along {count} of {flat.size} directions"
    return Laplace((axes / curvature) @ axes.T, smallest, repair)
