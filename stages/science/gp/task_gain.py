"""Samples of a trajectory that serve a task best, picked greedily, each given those before.

A model, (Q, D) inputs z_q of the task and the inputs of trajectories flow in; picks and gains flow out. A `TaskGain`
says what a measurement at x gains, of the posterior covariance c given the data, which falls with each pick:

    c(z_q, x)^2 / (c(x, x) + sn^2)    is what it takes from c(z_q, z_q)

Hyperparameters are held; neither data nor outputs are needed but for the model's.
"""

from abc import ABC, abstractmethod

import numpy as np
import scipy
from numpy.typing import NDArray

from stages.science.gp.kernel import Array
from stages.science.gp.marginal import MarginalGP
from stages.science.gp.posterior import check_points
from stages.science.gp.subsample import Displace, check_count


class Gains(ABC):
    """What one more measurement gains at each of T rows, given the picks so far."""

    @abstractmethod
    def of(self, noisy: Array) -> Array:
        """Return the gains, (T,), at rows whose variance with noise is (T,) `noisy`."""

    @abstractmethod
    def take(self, own: Array, along: Array) -> float:
        """Condition on one more pick and return what it gained.

        `own`, (k, T), and `along`, (k, Q), are the covariances of rows and of the task with the picks, each pick given
        those before and in units of its noisy standard deviation; the last is the new one.
        """


class TaskGain(ABC):
    """What measurements gain for a model's task; a subclass says in which `Gains`."""

    def __init__(self, model: MarginalGP, task: Array):
        self._lengths = model.hyperparameters.lengths
        self._signal, self._noise = model.hyperparameters.signal_variance, model.noise_variance
        self._whiten = model.whiten
        self._task = check_points(task, self._lengths.size, "task")
        if not len(self._task):
            raise ValueError("task: expected at least one input, got none")
        self._whitened_task = self._whiten(self._task)

    @abstractmethod
    def _begin(self, across: Array) -> Gains:
        """Return the gains before any pick, by the (T, Q) covariances of rows and task."""

    @abstractmethod
    def _add(self, taken: Array) -> Array:
        """Return the gain, (R,), of taking (R, Q) variances from the task's."""

    def pick(self, inputs: Array, count: int, displace: Displace | None = None) -> tuple[NDArray[np.intp], float]:
        """Return the rows of (T, D) inputs that gain most, (count,), in the order of picking, and what they gain.

        `displace` may take another row in place of each pick, as in `subsample`.
        """
        inputs = check_points(inputs, self._lengths.size)
        check_count(count, len(inputs))
        return self._pick(inputs, self._whiten(inputs), count, displace)

    def score(self, trajectories: Array, count: int) -> Array:
        """Return what the best `count` rows of each of (R, T, D) trajectories gain, (R,)."""
        whitened = self._whiten(trajectories.reshape(-1, trajectories.shape[-1])).reshape(-1, *trajectories.shape[:2])
        return np.array([self._pick(each, whitened[:, r], count)[1] for r, each in enumerate(trajectories)])

    def gain(self, trajectories: Array) -> Array:
        """Return what all samples of each of (R, T, D) trajectories gain together, (R,)."""
        noisy, across = self._condition(trajectories)
        noisy[:, np.arange(noisy.shape[1]), np.arange(noisy.shape[1])] += self._noise
        lower = np.linalg.cholesky(noisy)
        solved = [scipy.linalg.lapack.dtrtrs(its, each, lower=1)[0] for its, each in zip(lower, across, strict=True)]
        return self._add(np.square(solved).sum(axis=1))

    def _condition(self, trajectories: Array) -> tuple[Array, Array]:
        """Return the covariance c among the samples of each of (R, T, D) trajectories, and with the task, (R, T, Q)."""
        count, samples, inputs = trajectories.shape
        points = check_points(trajectories.reshape(-1, inputs), self._lengths.size)
        whitened, scaled = self._whiten(points), points / self._lengths
        across = (self._covary(scaled) - whitened.T @ self._whitened_task).reshape(count, samples, -1)
        along = whitened.T.reshape(count, samples, -1)
        squares = np.stack([_square_distances(each, each) for each in scaled.reshape(count, samples, inputs)])
        return self._signal * np.exp(-0.5 * squares) - along @ along.swapaxes(1, 2), across

    def _covary(self, scaled: Array) -> Array:
        """Return the prior covariance of (T, D) inputs, in units of the lengths, with the task, (T, Q)."""
        squares = _square_distances(scaled, self._task / self._lengths)
        return np.asarray(self._signal * np.exp(-0.5 * squares))

    def _variance(self, whitened: Array) -> Array:
        return np.maximum(self._signal - np.square(whitened).sum(axis=0), 0.0)

    def _pick(
        self, inputs: Array, whitened: Array, count: int, displace: Displace | None = None
    ) -> tuple[NDArray[np.intp], float]:
        scaled = inputs / self._lengths
        across = self._covary(scaled) - whitened.T @ self._whitened_task
        variance, left = self._variance(whitened), self._begin(across)
        picks: list[int] = []
        own, along = np.empty((count, len(inputs))), np.empty((count, len(self._task)))
        gained = 0.0
        for k in range(count):  # `across` stays as it is: earlier picks took own[:k]' along[:k] from it
            gains = left.of(variance + self._noise)
            gains[picks] = -np.inf
            best = int(np.argmax(gains))
            if displace is not None:
                best = displace(best, picks)
            before, scale = own[:k, best].copy(), np.sqrt(variance[best] + self._noise)
            squares = np.square(scaled - scaled[best]).sum(axis=1)
            column = self._signal * np.exp(-0.5 * squares) - whitened[:, best] @ whitened
            own[k] = (column - before @ own[:k]) / scale
            along[k] = (across[best] - before @ along[:k]) / scale
            gained += left.take(own[: k + 1], along[: k + 1])
            variance = np.maximum(variance - np.square(own[k]), 0.0)
            picks.append(best)
        return np.array(picks, dtype=np.intp), gained


def _square_distances(one: Array, other: Array) -> Array:
    from scipy.spatial.distance import cdist  # slow to import, and most commands choose nothing

    return np.asarray(cdist(one, other, "sqeuclidean"))
