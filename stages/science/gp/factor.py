"""The Cholesky factor of a noisy covariance, with a stated repair.

A covariance matrix flows in; its lower factor, the inverse of that factor and the jitter that was needed flow out.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from stages.science.gp.kernel import Array

RELATIVE_JITTERS = (0.0, 1e-12, 1e-10, 1e-8)
"""Tried in turn, times the mean of the diagonal."""


class FactorisationError(ValueError):
    """A covariance is not finite, or not positive definite even with jitter; the message names rows that coincide."""


@dataclass(frozen=True)
class Factor:
    """C + jitter I = lower lower', (N, N) each; `repair` names the rows that made jitter necessary, or is empty."""

    lower: Array
    jitter: float
    repair: str

    @cached_property
    def inverse(self) -> Array:
        """Inverse of the lower factor, (N, N): C^-1 = inverse' inverse is never formed to predict."""
        return np.ascontiguousarray(scipy.linalg.lapack.dtrtri(self.lower, lower=1)[0])

    @property
    def log_determinant(self) -> float:
        """Of C + jitter I."""
        return float(2.0 * np.log(self.lower.diagonal()).sum())

    def whiten(self, columns: Array) -> Array:
        """Return lower^-1 columns."""
        return np.asarray(scipy.linalg.lapack.dtrtrs(self.lower, columns, lower=1)[0])

    def solve(self, columns: Array) -> Array:
        """Return C^-1 columns."""
        return np.asarray(scipy.linalg.lapack.dtrtrs(self.lower, self.whiten(columns), lower=1, trans=1)[0])


def factorise(covariance: Array, scaled: Array) -> Factor:
    """Factorise a covariance, adding the smallest jitter of `RELATIVE_JITTERS` that makes it possible.

    A pivot that is no more than rounding counts as a failure: what follows from it would be noise.

    The covariance is (N, N); its rows' (N, D) inputs, in units of the kernel's lengths, are for the message of a
    `FactorisationError`: the covariance is not finite, or no jitter suffices.
    """
    if not np.isfinite(covariance).all():
        raise FactorisationError(f"the covariance of {len(scaled)} points is not finite: hyperparameters out of range")
    scale = float(covariance.diagonal().sum() / len(covariance))
    rounding = len(covariance) * np.finfo(float).eps * scale
    for relative in RELATIVE_JITTERS:
        jitter = relative * scale
        shifted = covariance + jitter * np.eye(len(covariance)) if jitter else covariance
        lower, failed = scipy.linalg.lapack.dpotrf(shifted, lower=1, clean=1)
        if not failed and lower.diagonal().min() ** 2 > rounding:
            repair = f"jitter {jitter:.1e} on the covariance's diagonal: {_describe_closest(scaled)}" if jitter else ""
            return Factor(lower, jitter, repair)
    raise FactorisationError(
        f"the covariance of {len(scaled)} points is not positive definite: {_describe_closest(scaled)}; "
        "remove one or raise the noise"
    )


def _describe_closest(scaled: Array) -> str:
    rows, distance = (0, 0), 0.0
    if len(scaled) > 1:
        pairs = np.column_stack(np.triu_indices(len(scaled), 1))
        distances = np.sqrt(((scaled[pairs[:, 0]] - scaled[pairs[:, 1]]) ** 2).sum(axis=1))
        rows, distance = pairs[np.argmin(distances)], distances.min()
    return f"rows {rows[0]} and {rows[1]} are nearly the same (distance {distance:.3g})"
