"""The maximum of the log posterior: Newton's method in a trust region, from several starts.

Starts are ranked by their value, the best few are climbed to a local maximum each, and the highest wins. Where there
are many points, fresh starts get near a maximum by gradients alone, which cost a fraction of a Hessian. Directions of
positive curvature are climbed by the size of their curvature (saddle-free) and saddles are left along them, so that no
climb ends at one. A climb that is about to repeat an earlier one is not finished.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from stages.science.gp.factor import FactorisationError
from stages.science.gp.kernel import Array
from stages.science.gp.posterior import LogPosterior

GRADIENT_TOLERANCE = 1e-9
CURVATURE_TOLERANCE = 1e-6
LARGEST_STEP = 4.0
SMALLEST_STEP = 1e-14
CLIMBS, ITERATIONS = 4, 200
NEAR = 1e-3
"""Share of the log posterior that a step by gradients adds at least; where it adds less, Newton's method takes over."""
APPROACH = 40
"""Steps by gradients at most."""
FEW = 200
"""Entries of the inputs, points times dimensions, up to which Newton's method from the start on takes no longer."""
SAME = 0.1
"""Distance of a Newton step's end to a known maximum within which a climb counts as a repetition, and share of what the
log posterior fell from it (or nats) that it may lie off the parabola."""


@dataclass(frozen=True)
class Place:
    """Where a climb stands or ends: theta, (P,), and the log posterior (nats), its gradient and its Hessian, (P, P).

    The Hessian's eigenvalues, ascending, are the curvature along the (P, P) axes, in columns.
    """

    theta: Array
    value: float
    gradient: Array
    hessian: Array
    curvature: Array
    axes: Array

    @classmethod
    def at(cls, posterior: LogPosterior, theta: Array) -> Place | None:
        """Return the place at theta, or None where the posterior cannot be evaluated."""
        try:
            value, gradient, hessian = posterior.derivatives(theta)
        except FactorisationError:
            return None
        return cls(theta, value, gradient, hessian, *np.linalg.eigh(hessian))

    @property
    def gradient_norm(self) -> float:
        """Largest entry of the gradient."""
        return float(np.abs(self.gradient).max())

    @property
    def is_flat(self) -> bool:
        """Whether the gradient is zero to tolerance."""
        return self.gradient_norm <= GRADIENT_TOLERANCE * max(1.0, abs(self.value))

    def step(self) -> Array:
        """Return the saddle-free Newton step, (P,); from a saddle, a step along its steepest way out."""
        if self.is_flat:
            return 0.1 * self.axes[:, -1]
        return self._newton_step(self.gradient)

    def _newton_step(self, gradient: Array) -> Array:
        along = self.axes.T @ gradient
        return np.asarray(self.axes @ (along / np.maximum(np.abs(self.curvature), 1e-10)))

    def draws(self, theta: Array, value: float, gradient: Array) -> bool:
        """Return whether a climb from a place, (P,), is about to end at this maximum, by the parabola about it."""
        away = theta - self.theta
        fallen = float(-0.5 * away @ self.hessian @ away)
        lies_on_it = abs(self.value - value - fallen) <= SAME * max(1.0, fallen)
        return lies_on_it and float(np.linalg.norm(away + self._newton_step(gradient))) <= SAME

    def is_below(self, other: Place) -> bool:
        """Return whether another place is higher, or as high to rounding and flatter."""
        gained = other.value - self.value
        return gained > 0 or (gained > -1e-13 * max(1.0, abs(self.value)) and other.gradient_norm < self.gradient_norm)


def find_map(
    posterior: LogPosterior, generator: np.random.Generator, starts: int, warm_starts: Sequence[Array] = ()
) -> Place:
    """Return the highest local maximum found.

    The generator draws so many starts from the hyperprior, beside its mean; the (P,) warm starts are always climbed. A
    `ValueError` tells a warm start of the wrong shape, a `FactorisationError` that no start has a covariance that can
    be factorised.
    """
    for theta in warm_starts:
        if np.shape(theta) != posterior.prior.mean.shape:
            raise ValueError(f"warm start: expected {posterior.prior.mean.size} entries, got shape {np.shape(theta)}")
    fresh = [posterior.prior.mean, *posterior.prior.draw(starts, generator)]
    values = np.array([_value_or_minus_infinity(posterior, theta) for theta in fresh])
    ranked = np.argsort(-values, kind="stable")[: max(1, CLIMBS - len(warm_starts))]
    found: list[Place] = []
    many = posterior.inputs.size > FEW
    begun = (approach(posterior, fresh[index], found) if many else fresh[index] for index in ranked)
    for start in chain(warm_starts, begun):
        maximum = None if start is None else climb(posterior, start, found)
        if maximum is not None:
            found.append(maximum)
    if not found:
        posterior.derivatives(posterior.prior.mean)
        raise FactorisationError("no start of the search has a log posterior that can be evaluated")
    return max(found, key=lambda each: each.value)


class _Repetition(Exception):
    """An approach is about to end at a known maximum."""


def approach(posterior: LogPosterior, start: Array, known: Sequence[Place] = ()) -> Array | None:
    """Return a place near a local maximum, (P,), from a start by gradients (L-BFGS-B; Byrd et al. 1995).

    None where it is about to end at one of the known maxima.
    """
    from scipy.optimize import minimize  # a fifth of a second that most commands need not wait for

    def descend(theta: Array) -> tuple[float, Array]:
        try:
            value, gradient = posterior.ascent(theta)
        except FactorisationError:
            return np.inf, np.zeros_like(theta)
        if any(each.draws(theta, value, gradient) for each in known):
            raise _Repetition
        return -value, -gradient

    try:
        found = minimize(descend, start, jac=True, method="L-BFGS-B", options={"maxiter": APPROACH, "ftol": NEAR})
    except _Repetition:
        return None
    return np.asarray(found.x if np.isfinite(found.fun) else start)


def climb(posterior: LogPosterior, start: Array, known: Sequence[Place] = ()) -> Place | None:
    """Climb from one start to a local maximum; None when that cannot begin, or is about to end at a known maximum."""
    here = Place.at(posterior, np.array(start, dtype=float))
    if here is None:
        return None
    radius = 1.0
    for _ in range(ITERATIONS):
        is_peak_shaped = here.curvature[-1] <= CURVATURE_TOLERANCE * np.abs(here.curvature).max()
        if here.is_flat and is_peak_shaped:
            break
        if any(each.draws(here.theta, here.value, here.gradient) for each in known):
            return None
        step = here.step()
        length = float(np.linalg.norm(step))
        if length > radius:
            step *= radius / length
        there = Place.at(posterior, here.theta + step)
        if there is not None and here.is_below(there):
            predicted = float(here.gradient @ step + 0.5 * here.curvature @ (here.axes.T @ step) ** 2)
            if there.value - here.value > 0.5 * predicted:
                radius = min(LARGEST_STEP, max(radius, 2.0 * length))
            here = there
        else:
            radius = 0.25 * min(radius, length)
            if radius < SMALLEST_STEP * max(1.0, float(np.abs(here.theta).max())):
                break
    return here


def _value_or_minus_infinity(posterior: LogPosterior, theta: Array) -> float:
    try:
        value = posterior.value(theta)
    except FactorisationError:
        return -np.inf
    return value if np.isfinite(value) else -np.inf
