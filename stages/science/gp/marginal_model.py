"""What the marginal GPs share, exact or sparse: predictions, slopes and utilities of many points, chunk by chunk.

A model's `Moments` and the Laplace approximation of its hyperparameters flow in; predictions, derivatives by theta and
utilities of (B, D) points flow out, with working memory that is bounded.

Where V is no more than its rounding error, f is known whatever the hyperparameters: V >= 0 for every theta, so V = 0 is
a minimum over theta, dV = 0 there, and dV'S dV / (3 V) -> 0 with V because dV'dV = O(V^2) at a noise-free datum. That
term is left out there, as is dV in dl, and V is held at its rounding error, so that all utilities stay finite.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property
from typing import Protocol

import numpy as np

from stages.science.gp.factor import FactorisationError
from stages.science.gp.hyperprior import Hyperprior
from stages.science.gp.kernel import Array, Hyperparameters
from stages.science.gp.laplace import Laplace, accept, approximate
from stages.science.gp.posterior import check_points, find_bad_row
from stages.science.gp.prediction import Moments
from stages.science.gp.utilities import PredictiveTerms
from stages.science.gp.utility_names import find_utility

MEMORY_MB = 64.0


class ChunkPredictor(Protocol):
    """Predicts chunks of points, with working memory of its own; `floor` is the rounding error of V."""

    floor: float

    def predict_mean(self, points: Array) -> Array:
        """Return the mean, (B,)."""

    def predict(self, points: Array) -> tuple[Array, Array]:
        """Return mean and variance, (B,) each."""

    def differentiate(self, points: Array) -> Moments:
        """Return mean and variance with their derivatives."""


class MarginalModel(ABC):
    """A GP at given hyperparameters that knows how uncertain they are; a subclass says how it predicts a chunk.

    Its (P,) hyperparameters are theta; S may be given instead of their Laplace approximation.
    """

    def __init__(self, theta: Array, hyperparameters: Hyperparameters, prior: Hyperprior, covariance: Array | None):
        self.theta, self.hyperparameters, self.prior = theta, hyperparameters, prior
        self._given = None if covariance is None else accept(covariance, theta.size)

    @property
    @abstractmethod
    def log_posterior(self) -> float:
        """At theta (nats)."""

    @abstractmethod
    def _curvature(self) -> Array:
        """Return the Hessian of the log posterior at theta, (P, P)."""

    @property
    @abstractmethod
    def _jitter_repair(self) -> str:
        """What jitter repaired; empty when nothing."""

    @abstractmethod
    def _predictor(self, size: int) -> ChunkPredictor:
        """Return what predicts chunks of at most so many points."""

    @abstractmethod
    def _chunk_size(self, memory_mb: float) -> int:
        """Return how many points fit; depends on the model's size and the memory alone."""

    @cached_property
    def laplace(self) -> Laplace:
        """The Laplace approximation at theta, or the covariance that was given."""
        return self._given or approximate(self._curvature(), self.prior)

    @property
    def repair(self) -> str:
        """What was repaired, for the record; empty when nothing was."""
        return "; ".join(each for each in (self.laplace.repair, self._jitter_repair) if each)

    @property
    def noise_variance(self) -> float:
        """sn^2."""
        return self.hyperparameters.noise_variance

    def predict_mean(self, points: Array) -> Array:
        """Return the predictive mean of (B, D) points, (B,)."""
        return self._gather(points, 1, lambda predictor, chunk: predictor.predict_mean(chunk)[None])[0]

    def predict(self, points: Array) -> tuple[Array, Array]:
        """Return the predictive mean and variance of f at (B, D) points, (B,) each."""
        mean, variance = self._gather(points, 2, lambda predictor, chunk: np.stack(predictor.predict(chunk)))
        return mean, variance

    def predict_marginal(self, points: Array) -> tuple[Array, Array]:
        """Return mean and variance of f with the hyperparameters marginalised, (B,) each.

        The mean is that of the plain GP (Garnett, Osborne and Hennig 2014).
        """

        def evaluate(predictor: ChunkPredictor, chunk: Array) -> Array:
            mean, terms = self._terms(predictor, chunk)
            return np.stack([mean, terms.marginal_variance])

        mean, variance = self._gather(points, 2, evaluate)
        return mean, variance

    def utility(self, points: Array, name: str, memory_mb: float = MEMORY_MB) -> Array:
        """Return a point utility, (B,), of standardised inputs, (B, D), by its name or the dotted path of one's own.

        Names are those of `UTILITIES`. The working memory beyond the result and the model's own matrices is bounded,
        MB. A `ValueError` tells an unknown name, a function of one's own that returns no scores, and points of the
        wrong shape or not finite.
        """
        if name == "variance":  # asks for no slopes
            return self._gather(points, 1, lambda predictor, chunk: predictor.predict(chunk)[1][None], memory_mb)[0]
        score = find_utility(name)
        return self._gather(points, 1, lambda *each: score(self._terms(*each)[1])[None], memory_mb)[0]

    def sensitivities(self, points: Array) -> tuple[Array, Array]:
        """Return dm/dtheta and dV/dtheta at (B, D) points, (B, P) each."""
        size = self.theta.size

        def evaluate(predictor: ChunkPredictor, chunk: Array) -> Array:
            moments = predictor.differentiate(chunk)
            return np.vstack([moments.mean_slope, moments.variance_slope])

        found = self._gather(points, 2 * size, evaluate)
        return found[:size].T, found[size:].T

    def _terms(self, predictor: ChunkPredictor, chunk: Array) -> tuple[Array, PredictiveTerms]:
        moments = predictor.differentiate(chunk)
        mean, variance = (self.laplace.root.T @ each for each in (moments.mean_slope, moments.variance_slope))
        known = moments.variance <= predictor.floor
        if known.any():
            variance[:, known] = 0.0
        by_mean, by_variance = (np.einsum("pb,pb->b", each, each) for each in (mean, variance))
        q = by_mean + by_variance / (3.0 * moments.variance)
        noise = 2.0 * self.noise_variance * self.laplace.root[self.hyperparameters.lengths.size + 1]
        return moments.mean, PredictiveTerms(moments.variance, q, self.noise_variance, by_mean, variance, noise)

    def _gather(
        self, points: Array, rows: int, evaluate: Callable[[ChunkPredictor, Array], Array], memory_mb: float = MEMORY_MB
    ) -> Array:
        points = self._check(points)
        size = self._chunk_size(memory_mb)
        found = np.empty((rows, len(points)))
        predictor = self._predictor(min(size, max(1, len(points))))
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            for start in range(0, len(points), size):
                chunk = slice(start, min(start + size, len(points)))
                found[:, chunk] = evaluate(predictor, points[chunk])
        self._check_range(found.T)
        return found

    def _check_range(self, values: Array, largest: float = np.finfo(float).max) -> None:
        """Refuse (B, ...) values of points that are out of floating-point range."""
        row = find_bad_row(np.abs(values) <= largest)
        if row is not None:
            told = f"row {row} of the points is out of range at theta = {self.theta.tolist()}"
            raise FactorisationError(f"what is predicted at {told}")

    def _check(self, points: Array) -> Array:
        return check_points(points, self.hyperparameters.lengths.size)
