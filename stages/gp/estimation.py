"""The maximum of the log posterior: Newton's method in a trust region, from several starts.

Starts are ranked by their value, the best few are climbed to a local maximum each, and the highest wins. Directions of
positive curvature are climbed by the size of their curvature (saddle-free), so that no start ends at a saddle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stages.gp.factor import FactorisationError
from stages.gp.posterior import LogPosterior

Array = NDArray[np.float64]

GRADIENT_TOLERANCE = 1e-9
LARGEST_STEP = 4.0
SMALLEST_STEP = 1e-14


@dataclass(frozen=True)
class Maximum:
    """A local maximum.

    Parameters
    ----------
    theta : (P,) float array
        Where.
    value : float
        Log posterior there (nats).
    gradient_norm : float
        Largest entry of the gradient there.
    """

    theta: Array
    value: float
    gradient_norm: float


def find_map(
    posterior: LogPosterior,
    generator: np.random.Generator,
    starts: int,
    warm_starts: Sequence[Array] = (),
    climbs: int = 4,
) -> Maximum:
    """Return the highest local maximum found.

    Parameters
    ----------
    posterior : LogPosterior
        To be maximised.
    generator : Generator
        Draws starts from the hyperprior.
    starts : int
        Draws, beside the prior's mean and the warm starts.
    warm_starts : sequence of (P,) float arrays
        Always climbed.
    climbs : int
        How many of the other starts are climbed, the highest first.

    Raises
    ------
    FactorisationError
        When no start has a covariance that can be factorised.
    """
    fresh = [posterior.prior.mean, *posterior.prior.draw(starts, generator)]
    values = [_value_or_minus_infinity(posterior, theta) for theta in fresh]
    ranked = [
        fresh[index] for index in np.argsort(-np.array(values), kind="stable")[:climbs] if np.isfinite(values[index])
    ]
    found = [climb(posterior, theta) for theta in [*warm_starts, *ranked]]
    if not found:
        posterior.value(posterior.prior.mean)
    return max(found, key=lambda each: each.value)


def climb(posterior: LogPosterior, start: Array, iterations: int = 200) -> Maximum:
    """Climb from one start to a local maximum.

    Parameters
    ----------
    posterior : LogPosterior
        To be maximised.
    start : (P,) float array
        Where to begin.
    iterations : int
        At most.
    """
    theta = np.array(start, dtype=float)
    value, gradient, hessian = posterior.derivatives(theta)
    radius = 1.0
    for _ in range(iterations):
        if np.abs(gradient).max() <= GRADIENT_TOLERANCE * max(1.0, abs(value)):
            break
        curvature, axes = np.linalg.eigh(hessian)
        along = axes.T @ gradient
        step = axes @ (along / np.maximum(np.abs(curvature), 1e-10))
        length = float(np.linalg.norm(step))
        if length > radius:
            step *= radius / length
        predicted = float(gradient @ step + 0.5 * step @ hessian @ step)
        try:
            trial = posterior.derivatives(theta + step)
        except FactorisationError:
            trial = (-np.inf, gradient, hessian)
        gained = trial[0] - value
        noise = 1e-13 * max(1.0, abs(value))
        better = gained > 0 or (gained > -noise and np.abs(trial[1]).max() < np.abs(gradient).max())
        if better:
            theta = theta + step
            value, gradient, hessian = trial
            if gained > 0.5 * predicted:
                radius = min(LARGEST_STEP, max(radius, 2.0 * length))
        else:
            radius = 0.25 * min(radius, length)
            if radius < SMALLEST_STEP * max(1.0, float(np.abs(theta).max())):
                break
    return Maximum(theta, value, float(np.abs(gradient).max()))


def _value_or_minus_infinity(posterior: LogPosterior, theta: Array) -> float:
    try:
        return posterior.value(theta)
    except FactorisationError:
        return -np.inf
