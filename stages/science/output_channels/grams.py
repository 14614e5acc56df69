"""Sums of products over the samples of each trial, of a fit's slopes and residual as of white noise.

Signals and a noise flow in; a linearised model's `Grams` flow out. Offset and gain of a trial are two directions of
length one: taken out of the plain sums, they come back over their own variance, so that no signal is whitened.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from stages.science.output_channels.noise import Noise, whiten
from stages.science.output_channels.output_channel import OutputChannel
from stages.science.output_channels.trial_noise import TrialNoise, find_directions
from stages.science.signals.trajectories import Array


@dataclass(frozen=True)
class Grams:
    """Sums over each trial's samples that a linearised model needs; K trials, P values."""

    slopes: Array
    cross: Array
    square: Array
    samples: Array

    def left_out(self, changes: Array) -> Array:
        """Return each trial's sum of squares after its own change of values, (K, P) ndarray."""
        curved = np.einsum("kp,kpq,kq->k", changes, self.slopes, changes)
        squares: Array = self.square - 2.0 * np.einsum("kp,kp->k", changes, self.cross) + curved
        return np.maximum(squares, 0.0)


@dataclass(frozen=True, eq=False)
class Columns:
    """What functions without a physical name add to a channel, (T, K, F), in its unit; zero where not present."""

    values: Array

    @cached_property
    def by_trial(self) -> Array:
        """The same, (K, T, F)."""
        return np.ascontiguousarray(self.values.transpose(1, 0, 2))

    @cached_property
    def products(self) -> Array:
        """Sums of their products over each trial's samples, (K, F, F)."""
        return self.by_trial.transpose(0, 2, 1) @ self.by_trial


class Collector:
    """Sums of products of an output's signals, and of columns beside them, whose own sums are told once.

    A trial's gain multiplies the simulated signal, (T, K): that of the noise if it has one, else the one given.
    """

    def __init__(
        self,
        output: OutputChannel,
        noise: Noise | TrialNoise,
        columns: Columns | None = None,
        simulated: Array | None = None,
    ) -> None:
        self.output, self.columns = output, columns
        self.samples = output.present.sum(axis=0).astype(float)
        if isinstance(noise, TrialNoise):
            simulated = noise.simulated
        self.directions = find_directions(output.measured if simulated is None else simulated, output)
        self.beside = None if columns is None else self.directions @ columns.by_trial

    def collect(self, signals: Array, noise: Noise | TrialNoise | None) -> Grams:
        """Return the sums of slopes and, last, a residual, (T, K, P + 1), zero where not present, and of the columns.

        They are as of white noise of variance one; without a noise, plain ones of the shapes of trials.
        """
        if isinstance(noise, Noise) and not noise.is_white:
            extended = signals if self.columns is None else np.insert(signals, [-1], self.columns.values, axis=2)
            white = whiten(extended, self.output.present, noise, self.output.step_s)
            return collect_grams(white[:, :, :-1], white[:, :, -1], self.output.present)
        by_trial = np.ascontiguousarray(signals.transpose(1, 0, 2))
        own, parts = by_trial.transpose(0, 2, 1) @ by_trial, self.directions @ by_trial
        slopes, cross, square = own[:, :-1, :-1], own[:, :-1, -1], own[:, -1, -1]
        along, rest = parts[:, :, :-1], parts[:, :, -1:]
        if self.columns is not None and self.beside is not None:
            across = by_trial.transpose(0, 2, 1) @ self.columns.by_trial
            upper = np.concatenate([slopes, across[:, :-1]], axis=2)
            lower = np.concatenate([across[:, :-1].transpose(0, 2, 1), self.columns.products], axis=2)
            slopes, cross = np.concatenate([upper, lower], axis=1), np.concatenate([cross, across[:, -1]], axis=1)
            along = np.concatenate([along, self.beside], axis=2)
        base, others = self._weigh(noise)
        weighed = (others[:, :, None] * along).transpose(0, 2, 1)
        return Grams(
            base * slopes + weighed @ along,
            base * cross + (weighed @ rest)[:, :, 0],
            base * square + (others * rest[:, :, 0] ** 2).sum(axis=1),
            self.samples,
        )

    def collect_alone(self, residual: Array, noise: Noise | TrialNoise) -> Array:
        """Return the sum of squares of each trial's residual, (K,), of (T, K), as of white noise of variance one."""
        if isinstance(noise, Noise) and not noise.is_white:
            white = whiten(residual[:, :, None], self.output.present, noise, self.output.step_s)
            return np.asarray((white**2).sum(axis=(0, 2)))
        base, others = self._weigh(noise)
        parts = np.matmul(self.directions, residual.T[:, :, None])[:, :, 0]
        return np.asarray(base * (residual**2).sum(axis=0) + (others * parts**2).sum(axis=1))

    def _weigh(self, noise: Noise | TrialNoise | None) -> tuple[float, Array]:
        """Return the weight of all products, and what is added to it along the two directions, (K, 2)."""
        count = self.samples[:, None]
        if noise is None:
            return 1.0, np.full((len(count), 2), -1.0)
        if isinstance(noise, Noise):
            return noise.white**-2, np.zeros((len(count), 2))
        sds = np.array([noise.offset, noise.gain])
        return noise.shape**-2, 1.0 / (noise.shape**2 + np.maximum(count, 1.0) * sds**2) - noise.shape**-2


def collect_grams(slopes: Array, residual: Array, present: NDArray[np.bool_]) -> Grams:
    """Return the sums over samples of each trial."""
    by_trial = np.ascontiguousarray(slopes.transpose(1, 0, 2))
    columns = np.ascontiguousarray(residual.T)
    return Grams(
        by_trial.transpose(0, 2, 1) @ by_trial,
        (columns[:, None, :] @ by_trial)[:, 0, :],
        (columns**2).sum(axis=1),
        present.sum(axis=0).astype(float),
    )
