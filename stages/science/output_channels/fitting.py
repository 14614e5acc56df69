"""Nominal constants and effects fitted together, by simulation, to one output.

An output and a list of forms flow in; out flows a `Fit`: values within bounds at the largest posterior density, and for
each trial what leaving it out would change. Steps are Gauss-Newton's with bounds; derivatives are differences of
simulations.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Self

import numpy as np
from numpy.typing import NDArray

from stages.science.output_channels.grams import Collector, Columns, Grams
from stages.science.output_channels.noise import Noise
from stages.science.output_channels.output_channel import OutputChannel
from stages.science.output_channels.trial_noise import TrialNoise
from stages.science.plant.effect import NamedEffect, Parameter
from stages.science.signals.trajectories import Array

STEP = 1e-4
"""Step of a finite difference, in standard deviations of the prior."""
ITERATIONS = 12
DAMPINGS = (0.01, 0.1, 1.0, 10.0)
"""Levenberg-Marquardt damping, tried in turn where no fraction of the full step lowers the cost."""
ROUNDING = 1e-13
"""Share of the curvature's trace that is added to its diagonal to keep it regular."""
ENOUGH = 1e-5
"""Relative fall of the cost below which a fit has converged."""


@dataclass(frozen=True, eq=False)
class Family:
    """A family of functions without a physical name, linear in its weights."""

    columns: Columns
    """What each weight of one adds to the channel."""
    sd: Array
    """Standard deviations of the weights' priors, (F,), whose means are zero."""


@dataclass(frozen=True)
class Model:
    """The nominal model of an output channel with a list of effects; it names the entries of a parameter vector.

    A family is added to the simulated channel; its weights are the last entries.
    """

    output: OutputChannel
    forms: tuple[NamedEffect, ...] = ()
    family: Family | None = None

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Constants, then the parameters of each effect."""
        return (*self.output.constants, *(each for form in self.forms for each in form.parameters))

    @property
    def weights_sd(self) -> Array:
        """Standard deviations of the priors of the family's weights, (F,) ndarray."""
        return np.empty(0) if self.family is None else self.family.sd

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds."""
        free = np.full(len(self.weights_sd), np.inf)
        low, high = [p.low for p in self.parameters], [p.high for p in self.parameters]
        return np.append(low, -free), np.append(high, free)

    @property
    def prior(self) -> tuple[Array, Array]:
        """Means and standard deviations of the priors."""
        means, sds = [p.prior_mean for p in self.parameters], [p.prior_sd for p in self.parameters]
        return np.append(means, np.zeros(len(self.weights_sd))), np.append(sds, self.weights_sd)

    @property
    def start(self) -> Array:
        """Values at which a fit starts: prior means of constants and weights, the first start of each parameter."""
        means = [each.prior_mean for each in self.output.constants]
        starts = [each.starts[0] for form in self.forms for each in form.parameters]
        return np.array([*means, *starts, *np.zeros(len(self.weights_sd))], dtype=float)

    def take(self, trials: Sequence[int]) -> Self:
        """Return the model on some of its trials, by position."""
        family = self.family and Family(Columns(self.family.columns.values[:, list(trials)]), self.family.sd)
        return replace(self, output=self.output.take(trials), family=family)

    def name_values(self, values: Array) -> tuple[dict[str, float], list[tuple[NamedEffect, dict[str, float]]]]:
        """Return values by name: the constants', and each effect's."""
        names = [each.name for each in self.output.constants]
        constants = dict(zip(names, map(float, values), strict=False))
        place, effects = len(names), []
        for form in self.forms:
            taken = values[place : place + len(form.parameters)]
            effects.append((form, {p.name: float(v) for p, v in zip(form.parameters, taken, strict=True)}))
            place += len(form.parameters)
        return constants, effects

    def simulate(self, values: Array) -> Array:
        """Return the channel, (T, K)."""
        simulated = self.output.simulate(*self.name_values(values))
        if self.family is not None:
            simulated = simulated + self.family.columns.values @ values[len(self.parameters) :]
        return simulated

    def differentiate(self, values: Array, simulated: Array) -> Array:
        """Return the derivatives of the channel by each named value, (T, K, P), zero where not present."""
        named = len(self.parameters)
        values, weights = values[:named], values[named:]
        high, sd = self.bounds[1][:named], self.prior[1][:named]
        steps = np.where(values + STEP * sd <= high, STEP * sd, -STEP * sd)
        moved = self.output.simulate_each([self.name_values(each) for each in values + np.diag(steps)])
        bare = simulated if self.family is None else simulated - self.family.columns.values @ weights
        moved -= bare[:, :, None]
        moved /= steps
        moved[~self.output.present] = 0.0
        return moved


@dataclass(frozen=True)
class Fit:
    """A fitted model."""

    model: Model
    values: Array
    """At the largest posterior density, (P,)."""
    residual: Array
    """Measured less simulated, (T, K), zero where not present."""
    slopes: Array
    """Derivatives of the simulated by the values, (T, K, P), zero where not present."""
    white: Grams
    """By trial, of whitened signals."""
    free: NDArray[np.bool_]
    """Which values are not held by a bound, (P,)."""

    @property
    def spread(self) -> float:
        """Root mean square of the residual, no trial left out, in the channel's unit."""
        return float(np.sqrt((self.residual**2).sum() / max(self.model.output.present.sum(), 1)))

    @property
    def precision(self) -> Array:
        """The priors' precisions."""
        return 1.0 / self.model.prior[1] ** 2

    def change_without(self, weights: Array) -> Array:
        """Return the change of the fitted values, (B, P), when trials have weights, (B, K), other than one.

        Changes are within bounds; a value at a bound stays.
        """
        mean, sd = self.model.prior
        low, high = self.model.bounds
        changes = np.zeros((len(weights), len(self.values)))
        free = np.flatnonzero(self.free)
        pull = (mean - self.values) / sd**2
        slopes = self.white.slopes[:, free[:, None], free]
        curvature = np.tensordot(weights, slopes, 1) + np.diag(self.precision[free])
        gradient = weights @ self.white.cross[:, free] + pull[free]
        room = (low - self.values)[free], (high - self.values)[free]
        scaled = curvature * sd[free] * sd[free][:, None]
        firm = ROUNDING * np.trace(scaled, axis1=1, axis2=2)  # values that the data tell as one, to the last digit
        scaled = scaled + firm[:, None, None] * np.eye(len(free))
        least = np.linalg.solve(scaled, (gradient * sd[free])[:, :, None])[:, :, 0] * sd[free]
        for row in np.flatnonzero(((least < room[0]) | (least > room[1])).any(axis=1)):
            least[row] = find_least(curvature[row], gradient[row], sd[free], *room)
        changes[:, free] = least
        return changes

    def cost(self, noise: Noise) -> float:
        """Return the whitened sum of squares under a noise, and that of the values' distances from their priors."""
        return _weigh_cost(self.model, self.values, self.residual, Collector(self.model.output, noise), noise)

    def drawn_values(self, weights: Array) -> Array:
        """Return the fitted values, (B, P), under weights of resampled trials (B, K); equal weights give these values.

        The fit may have been made under another noise, so only the spread of the resampled values is used.
        """
        equal = self.change_without(np.ones((1, weights.shape[1])))
        return np.asarray(np.clip(self.values + self.change_without(weights) - equal, *self.model.bounds))

    def leave_each_out(self) -> Array:
        """Return each trial's residual when it is left out of the fit, (T, K) ndarray."""
        changes = self.change_without(1.0 - np.eye(len(self.white.square)))
        moved = np.matmul(self.slopes.transpose(1, 0, 2), changes[:, :, None])[:, :, 0]
        return np.asarray(self.residual - moved.T)


def _weigh_cost(model: Model, values: Array, residual: Array, collector: Collector, noise: Noise | TrialNoise) -> float:
    mean, sd = model.prior
    return float(collector.collect_alone(residual, noise).sum() + (((values - mean) / sd) ** 2).sum())


def fit(model: Model, noise: Noise | TrialNoise, start: Array, iterations: int = ITERATIONS) -> Fit:
    """Fit a model under a noise from values, (P,), in some steps at most."""
    low, high = model.bounds
    mean, sd = model.prior
    present = model.output.present
    values = np.clip(start, low, high)

    def look(at: Array) -> tuple[Array, Array, float]:
        simulated = model.simulate(at)
        residual = np.where(present, model.output.measured - simulated, 0.0)
        return simulated, residual, _weigh_cost(model, at, residual, collector, noise)

    def linearise() -> tuple[Array, Grams]:
        slopes = model.differentiate(values, simulated)
        return slopes, collector.collect(np.concatenate([slopes, residual[:, :, None]], axis=2), noise)

    collector = Collector(model.output, noise, None if model.family is None else model.family.columns)
    simulated, residual, cost = look(values)
    slopes, white = linearise()
    for _ in range(iterations):
        pull, precision, room = (mean - values) / sd**2, 1.0 / sd**2, (low - values, high - values)
        step = _bounded_step(white, pull, precision, *room)
        shorter = [0.5**halving * step for halving in range(6)]
        damped = (_bounded_step(white, pull, precision, *room, damping) for damping in DAMPINGS)
        for change in chain(shorter, damped):
            trial = np.clip(values + change, low, high)
            found = look(trial)
            if found[2] < cost:
                break
        else:
            break
        fallen = cost - found[2]
        values, (simulated, residual, cost) = trial, found
        slopes, white = linearise()
        if fallen < ENOUGH * cost:
            break
    if model.family is not None:
        slopes = np.concatenate([slopes, model.family.columns.values], axis=2)
    margin = 1e-9 * np.where(np.isfinite(high - low), high - low, 0.0)
    free = (values > low + margin) & (values < high - margin)
    return Fit(model, values, residual, slopes, white, free)


def _bounded_step(white: Grams, pull: Array, precision: Array, low: Array, high: Array, damping: float = 0.0) -> Array:
    """Return the step to the minimum of the quadratic model within bounds, with Levenberg-Marquardt damping."""
    curvature = white.slopes.sum(axis=0) + np.diag(precision)
    curvature = curvature + damping * np.diag(np.diag(curvature))
    return find_least(curvature, white.cross.sum(axis=0) + pull, 1.0 / np.sqrt(precision), low, high)


def find_least(curvature: Array, gradient: Array, scale: Array, low: Array, high: Array) -> Array:
    """Return the minimiser of half x' curvature x - gradient' x within bounds; `scale` conditions the problem.

    Clipping each value at its own bound would be wrong, as values that the data hardly distinguish move together.
    """
    from scipy.optimize import lsq_linear

    scaled = curvature * scale * scale[:, None]
    try:
        factor = np.linalg.cholesky(scaled)
    except np.linalg.LinAlgError:  # singular but for rounding
        sizes, directions = np.linalg.eigh(scaled)
        factor = directions * np.sqrt(np.maximum(sizes, 1e-9 * sizes.max()))
    target = np.linalg.solve(factor, scale * gradient)
    free: Array = np.linalg.solve(factor.T, target) * scale
    if ((free >= low) & (free <= high)).all():
        return free
    tight = (np.minimum(low / scale, -1e-12), np.maximum(high / scale, 1e-12))
    return np.asarray(lsq_linear(factor.T, target, bounds=tight, method="bvls").x * scale)
