"""A Gaussian process at the MAP of its hyperparameters, and the marginal GP around it.

Data, hyperprior and theta flow in; predictions, their derivatives by theta and the utilities of many points flow out,
in chunks whose working memory is bounded (`prediction` has the formulas).

Where V is no more than its rounding error, f is known whatever the hyperparameters: V >= 0 for every theta, so V = 0 is
a minimum over theta, dV = 0 there, and dV'S dV / (3 V) -> 0 with V because |dV|^2 = O(V^2) at a noise-free datum. That
term is left out there, and V is held at its rounding error, so that all utilities stay finite.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from stages.gp.estimation import find_map
from stages.gp.factor import Factor, FactorisationError, factorise
from stages.gp.hyperprior import Hyperprior
from stages.gp.kernel import covariance_among, squared_differences
from stages.gp.laplace import Laplace, accept, approximate
from stages.gp.posterior import LogPosterior, check_points, find_bad_row
from stages.gp.prediction import Predictor, chunk_rows, chunk_size
from stages.gp.utilities import PredictiveTerms, find_utility

Array = NDArray[np.float64]

MEMORY_MB = 64.0

LARGEST_SLOPE = 1e150
"""Its square is finite."""


class MarginalGP:
    """An exact GP at given hyperparameters, with their Laplace approximation.

    Parameters
    ----------
    posterior : LogPosterior
        Data and hyperprior.
    theta : (P,) float array
        Where to condition, usually the MAP.
    covariance : (P, P) float array, optional
        S, instead of the Laplace approximation at theta.

    Raises
    ------
    ValueError
        When theta or covariance has the wrong shape or is not finite.
    """

    def __init__(self, posterior: LogPosterior, theta: Array, covariance: Array | None = None):
        self.posterior = posterior
        self.theta = np.array(theta, dtype=float)
        self.hyperparameters = posterior.read(self.theta)
        self._given = None if covariance is None else accept(covariance, self.theta.size)

    @property
    def inputs(self) -> Array:
        """(N, D) standardised inputs."""
        return self.posterior.inputs

    @property
    def noise_variance(self) -> float:
        """sn^2."""
        return self.hyperparameters.noise_variance

    @cached_property
    def _factor(self) -> Factor:
        return self.posterior.factor(self.theta)

    @property
    def jitter(self) -> float:
        """What the factorisation needed on the diagonal; 0 when nothing."""
        return self._factor.jitter

    @cached_property
    def _derivatives(self) -> tuple[float, Array, Array]:
        return self.posterior.derivatives(self.theta)

    @property
    def log_posterior(self) -> float:
        """At theta (nats)."""
        return self._derivatives[0]

    @cached_property
    def laplace(self) -> Laplace:
        """The Laplace approximation at theta, or the covariance that was given."""
        return self._given or approximate(self._derivatives[2], self.posterior.prior)

    @property
    def repair(self) -> str:
        """What was repaired, for the record; empty when nothing was."""
        return "; ".join(each for each in (self.laplace.repair, self._factor.repair) if each)

    @cached_property
    def _weights(self) -> Array:
        return self._factor.solve(self.posterior.residual(self.theta))

    def grow(self, inputs: Array, outputs: Array) -> MarginalGP:
        """Return the model conditioned on more data, theta and S held."""
        posterior = LogPosterior(
            np.vstack([self.inputs, inputs]),
            np.concatenate([self.posterior.outputs, outputs]),
            self.posterior.prior,
            self.posterior.mean,
        )
        return MarginalGP(posterior, self.theta, self.laplace.covariance)

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

        def evaluate(predictor: Predictor, chunk: Array) -> Array:
            mean, terms = self._terms(predictor, chunk)
            return np.stack([mean, terms.marginal_variance])

        mean, variance = self._gather(points, 2, evaluate)
        return mean, variance

    def utility(self, points: Array, name: str, memory_mb: float = MEMORY_MB) -> Array:
        """Return a point utility of (B, D) points, (B,).

        Parameters
        ----------
        points : (B, D) float array
            Standardised inputs.
        name : str
            In `UTILITIES`.
        memory_mb : float
            Bound on the working memory beyond the result and the model's own matrices (MB).

        Raises
        ------
        ValueError
            When there is no utility of that name, or points have the wrong shape or are not finite.
        """
        score = find_utility(name)
        return self._gather(points, 1, lambda *each: score(self._terms(*each)[1])[None], memory_mb)[0]

    def sensitivities(self, points: Array) -> tuple[Array, Array]:
        """Return dm/dtheta and dV/dtheta at (B, D) points, (B, P) each."""
        size = self.theta.size

        def evaluate(predictor: Predictor, chunk: Array) -> Array:
            moments = predictor.differentiate(chunk)
            return np.vstack([moments.mean_slope, moments.variance_slope])

        found = self._gather(points, 2 * size, evaluate)
        return found[:size].T, found[size:].T

    def joint_information(self, points: Array) -> float:
        """Return the information that noisy measurements at all (T, D) points together bring about theta (nats).

        1/2 log det(I + S J' (V_TT + sn^2 I)^-1 J) with J = dm/dtheta; needs (D + 3) T^2 numbers of working memory.
        """
        points = self._check(points)
        predictor = self._predictor(max(1, len(points)))
        with np.errstate(over="ignore", invalid="ignore"):
            slopes = predictor.differentiate(points).mean_slope.T @ self.laplace.root
        self._check_range(slopes)
        v = predictor.whiten(points)
        noisy = covariance_among(squared_differences(points), self.hyperparameters) - v.T @ v
        noisy.flat[:: len(points) + 1] = np.maximum(np.diag(noisy), predictor.floor) + self.noise_variance
        whitened = factorise(noisy, points / self.hyperparameters.lengths).whiten(slopes)
        self._check_range(whitened, LARGEST_SLOPE)
        return 0.5 * float(np.log1p(np.linalg.svd(whitened, compute_uv=False) ** 2).sum())

    def _terms(self, predictor: Predictor, chunk: Array) -> tuple[Array, PredictiveTerms]:
        moments = predictor.differentiate(chunk)
        root = self.laplace.root.T
        through_mean = np.square(root @ moments.mean_slope).sum(axis=0)
        through_variance = np.square(root @ moments.variance_slope).sum(axis=0) / (3.0 * moments.variance)
        known = moments.variance <= predictor.floor
        q = through_mean + np.where(known, 0.0, through_variance)
        return moments.mean, PredictiveTerms(moments.variance, q, self.noise_variance)

    def _gather(
        self,
        points: Array,
        rows: int,
        evaluate: Callable[[Predictor, Array], Array],
        memory_mb: float = MEMORY_MB,
    ) -> Array:
        points = self._check(points)
        n, d = self.inputs.shape
        found = np.empty((rows, len(points)))
        predictor = self._predictor(min(chunk_size(n, d, memory_mb), max(1, len(points))))
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            for chunk in chunk_rows(len(points), n, d, memory_mb):
                found[:, chunk] = evaluate(predictor, points[chunk])
        self._check_range(found.T)
        return found

    def _check_range(self, values: Array, largest: float = np.finfo(float).max) -> None:
        """Refuse (B, ...) values of points that are out of floating-point range."""
        row = find_bad_row(np.abs(values) <= largest)
        if row is not None:
            raise FactorisationError(
                f"what is predicted at row {row} of the points is out of range at theta = {self.theta.tolist()}"
            )

    def _predictor(self, size: int) -> Predictor:
        return Predictor(self.posterior, self.theta, self._factor, self._weights, size)

    def _check(self, points: Array) -> Array:
        return check_points(points, self.inputs.shape[1])


def condition(
    inputs: Array,
    outputs: Array,
    theta: Array,
    prior: Hyperprior,
    mean: str = "zero",
    covariance: Array | None = None,
) -> MarginalGP:
    """Return the model at a given theta, without a search.

    Parameters
    ----------
    inputs, outputs : (N, D) and (N,) float arrays
        Standardised.
    theta : (P,) float array
        Hyperparameters.
    prior : Hyperprior
        For the Laplace approximation.
    mean : str
        ``zero`` or ``constant``.
    covariance : (P, P) float array, optional
        S, instead of the Laplace approximation.

    Raises
    ------
    ValueError
        When a shape does not fit or a value is not finite.
    """
    return MarginalGP(LogPosterior(inputs, outputs, prior, mean), theta, covariance)


def fit(
    inputs: Array,
    outputs: Array,
    prior: Hyperprior,
    mean: str = "zero",
    *,
    generator: np.random.Generator,
    starts: int = 8,
    warm_starts: Sequence[Array] = (),
) -> MarginalGP:
    """Return the model at the MAP of its hyperparameters.

    Parameters
    ----------
    inputs, outputs : (N, D) and (N,) float arrays
        Standardised.
    prior : Hyperprior
        Counted once.
    mean : str
        ``zero`` or ``constant``.
    generator : Generator
        Draws the starts.
    starts : int
        Draws from the hyperprior, beside its mean and the warm starts.
    warm_starts : sequence of (P,) float arrays
        Earlier maxima.

    Raises
    ------
    ValueError
        When a shape does not fit or a value is not finite.
    FactorisationError
        When rows nearly coincide and no start parts them.
    """
    posterior = LogPosterior(inputs, outputs, prior, mean)
    return MarginalGP(posterior, find_map(posterior, generator, starts, warm_starts).theta)
