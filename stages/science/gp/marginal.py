"""A Gaussian process at the MAP of its hyperparameters, and the marginal GP around it.

Data, hyperprior and theta flow in; predictions, their derivatives by theta and the utilities of many points flow out,
in chunks whose working memory is bounded (`prediction` has the formulas, `marginal_model` what the sparse one shares).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from stages.science.gp.estimation import find_map
from stages.science.gp.factor import Factor, factorise
from stages.science.gp.hyperprior import Hyperprior
from stages.science.gp.kernel import Array, covariance_among, squared_differences
from stages.science.gp.marginal_model import MarginalModel
from stages.science.gp.posterior import LogPosterior
from stages.science.gp.prediction import Predictor, limit_chunk

LARGEST_SLOPE = 1e150
"""Its square is finite."""


class MarginalGP(MarginalModel):
    """An exact GP at given hyperparameters, (P,), usually the MAP, with their Laplace approximation.

    S, (P, P), may be given instead. A `ValueError` tells a shape of theta or S that does not fit, or no finite value.
    """

    def __init__(self, posterior: LogPosterior, theta: Array, covariance: Array | None = None):
        self.posterior = posterior
        self._latest: tuple[int, Predictor] | None = None
        super().__init__(np.array(theta, dtype=float), posterior.read(theta), posterior.prior, covariance)

    @property
    def inputs(self) -> Array:
        """(N, D) standardised inputs."""
        return self.posterior.inputs

    @property
    def identity(self) -> bytes:
        """What models of the same data at the same theta have in common, which predict the same under one prior."""
        return self.theta.tobytes() + self.inputs.tobytes() + self.posterior.outputs.tobytes()

    @cached_property
    def _factor(self) -> Factor:
        return self.posterior.factor(self.theta)

    @property
    def jitter(self) -> float:
        """What the factorisation needed on the diagonal; 0 when nothing."""
        return self._factor.jitter

    @cached_property
    def derivatives(self) -> tuple[float, Array, Array]:
        """Value (nats), gradient (P,) and Hessian (P, P) of the log posterior at theta."""
        return self.posterior.derivatives(self.theta)

    @property
    def log_posterior(self) -> float:
        """At theta (nats)."""
        return self.derivatives[0]

    def _curvature(self) -> Array:
        return self.derivatives[2]

    @property
    def _jitter_repair(self) -> str:
        return self._factor.repair

    @cached_property
    def _weights(self) -> Array:
        return self._factor.solve(self.posterior.residual(self.theta))

    def grow(self, inputs: Array, outputs: Array) -> MarginalGP:
        """Return the model conditioned on more data, theta and S held."""
        known = self.posterior
        data = np.vstack([known.inputs, inputs]), np.concatenate([known.outputs, outputs])
        return condition(*data, self.theta, known.prior, known.mean, self.laplace.covariance)

    def whiten(self, points: Array) -> Array:
        """Return L^-1 k(X, x*) of (B, D) points, (N, B), by which the data explain their covariance."""
        points = self._check(points)
        return self._predictor(max(1, len(points))).whiten(points).copy()

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

    def _chunk_size(self, memory_mb: float) -> int:
        n, d = self.inputs.shape
        return limit_chunk(n * (2 * d + 4) + 20 * d + 36, memory_mb)

    def _predictor(self, size: int) -> Predictor:
        if self._latest is None or self._latest[0] != size:
            self._latest = size, Predictor(self.posterior, self.theta, self._factor, self._weights, size)
        return self._latest[1]


def condition(
    inputs: Array, outputs: Array, theta: Array, prior: Hyperprior, mean: str = "zero", covariance: Array | None = None
) -> MarginalGP:
    """Return the model at a given theta, without a search; takes what `fit` and `MarginalGP` do."""
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
    place = find_map(posterior, generator, starts, warm_starts)
    model = MarginalGP(posterior, place.theta)
    model.derivatives = place.value, place.gradient, place.hessian  # not to be evaluated once more
    return model
