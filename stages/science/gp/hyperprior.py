"""Independent Gaussian priors of the hyperparameters."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stages.science.gp.kernel import Array

LARGEST_MEAN = 1e50
SMALLEST_VARIANCE, LARGEST_VARIANCE = 1e-100, 1e100
"""Gradients within these bounds have finite squares."""


@dataclass(frozen=True)
class Hyperprior:
    """p(theta) = N(mean, diag(variance)), (P,) each: log lengths 1 to D, log signal SD, log noise SD and any mean.

    A `ValueError` tells shapes that differ, a value that is not finite or absurdly large, a variance not positive.
    """

    mean: Array
    variance: Array

    def __post_init__(self) -> None:
        mean, variance = (np.asarray(each, dtype=float) for each in (self.mean, self.variance))
        if mean.ndim != 1 or mean.shape != variance.shape:
            told = f"{mean.shape}, {variance.shape}"
            raise ValueError(f"hyperprior: expected mean and variance of one length, got {told}")
        in_range = (np.abs(mean) <= LARGEST_MEAN) & (variance >= SMALLEST_VARIANCE) & (variance <= LARGEST_VARIANCE)
        if not in_range.all():
            got = f"{mean.tolist()}, {variance.tolist()}"
            raise ValueError(
                f"hyperprior: expected finite means and positive variances, means within {LARGEST_MEAN:g} and "
                f"variances between {SMALLEST_VARIANCE:g} and {LARGEST_VARIANCE:g}, got {got}"
            )
        object.__setattr__(self, "mean", mean)
        object.__setattr__(self, "variance", variance)

    @property
    def precision(self) -> Array:
        """One over the variance, (P,)."""
        return 1.0 / self.variance

    @cached_property
    def _log_volume(self) -> Array:
        return np.log(2 * np.pi * self.variance)

    def log_density(self, theta: Array) -> float:
        """Log density at theta (nats)."""
        return float(-0.5 * ((theta - self.mean) ** 2 / self.variance + self._log_volume).sum())

    def gradient(self, theta: Array) -> Array:
        """Gradient of the log density, (P,)."""
        return (self.mean - theta) / self.variance

    def draw(self, count: int, generator: np.random.Generator) -> Array:
        """Draw (count, P) vectors."""
        return self.mean + np.sqrt(self.variance) * generator.standard_normal((count, self.mean.size))
