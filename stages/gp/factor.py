"""The Cholesky factor of a noisy covariance, with a stated repair.

A covariance matrix flows in; its lower factor, the inverse of that factor and the jitter that was needed flow out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

Array = NDArray[np.float64]

RELATIVE_JITTERS = (0.0, 1e-12, 1e-10, 1e-8)
"""Tried in turn, times the mean of the diagonal."""


class FactorisationError(ValueError):
    """A covariance is not positive definite, even with jitter; the message names the rows that coincide."""


@dataclass(frozen=True)
class Factor:
    """C + jitter I = lower lower'.

    Parameters
    ----------
    lower : (N, N) float array
        Lower triangular.
    inverse : (N, N) float array
        Its inverse, lower triangular: C^-1 = inverse' inverse, which is never formed to predict.
    jitter : float
        What was added to the diagonal; 0 when nothing was.
    """

    lower: Array
    inverse: Array
    jitter: float

    @property
    def log_determinant(self) -> float:
        """Of C + jitter I."""
        return float(2.0 * np.log(np.diag(self.lower)).sum())

    def whiten(self, columns: Array) -> Array:
        """Return lower^-1 columns."""
        return self.inverse @ columns

    def solve(self, columns: Array) -> Array:
        """Return C^-1 columns."""
        return self.inverse.T @ (self.inverse @ columns)


def factorise(covariance: Array, inputs: Array) -> Factor:
    """Factorise a covariance, adding the smallest jitter of `RELATIVE_JITTERS` that makes it possible.

    Parameters
    ----------
    covariance : (N, N) float array
        Symmetric.
    inputs : (N, D) float array
        Its rows' inputs, for the message.

    Raises
    ------
    FactorisationError
        When no jitter suffices.
    """
    scale = float(np.mean(np.diag(covariance)))
    if np.isfinite(covariance).all():
        for relative in RELATIVE_JITTERS:
            jitter = relative * scale
            shifted = covariance + jitter * np.eye(len(covariance)) if jitter else covariance
            lower, failed = lapack.dpotrf(shifted, lower=1, clean=1)
            if failed:
                continue
            inverse, singular = lapack.dtrtri(lower, lower=1)
            if not singular and np.isfinite(inverse).all():
                return Factor(lower, np.ascontiguousarray(inverse), jitter)
    first, second, distance = closest_rows(inputs)
    raise FactorisationError(
        f"the covariance of {len(inputs)} points is not positive definite: rows {first} and {second} are nearly the "
        f"same (distance {distance:.3g}); remove one or raise the noise"
    )


def closest_rows(inputs: Array) -> tuple[int, int, float]:
    """Return the two rows that lie closest together, and their distance."""
    if len(inputs) < 2:
        return 0, 0, 0.0
    squared = ((inputs[:, None, :] - inputs[None, :, :]) ** 2).sum(axis=2)
    squared[np.tril_indices(len(inputs))] = np.inf
    first, second = np.unravel_index(int(np.argmin(squared)), squared.shape)
    return int(first), int(second), float(np.sqrt(squared[first, second]))
