"""What noisy measurements take from a model's mean posterior variance over the inputs that it is wanted for, its task.

With c the posterior covariance given the data, a measurement at x takes

    1/Q sum_q c(z_q, x)^2 / (c(x, x) + sn^2)

from the mean of c(z_q, z_q): the I-optimal design of Seo, Wallat, Graepel and Obermayer, Gaussian process regression:
active data selection (IJCNN 2000), in the square of standard units.
"""

import numpy as np
from numba import njit

from stages.science.gp.kernel import Array
from stages.science.gp.subsample import check_count
from stages.science.gp.task_gain import Gains, TaskGain

INTEGRATED_VARIANCE = "integrated_variance"

LARGEST_BLOCK = 500_000
"""Covariances of samples with a task that are held at a time, 4 MB."""


class VarianceTaken(Gains):
    """By the squared norms of rows of the covariance with the task, updated without the covariance itself."""

    def __init__(self, across: Array):
        self._across = across
        self._norms = np.einsum("tq,tq->t", across, across)

    def of(self, noisy: Array) -> Array:
        """Return what a measurement at each row takes from the mean variance, (T,)."""
        return self._norms / (self._across.shape[1] * noisy)

    def take(self, own: Array, along: Array) -> float:
        """Condition on one more pick and return what it took."""
        taken = float(along[-1] @ along[-1])
        shared = self._across @ along[-1] - (along[:-1] @ along[-1]) @ own[:-1]
        self._norms = np.maximum(self._norms - 2.0 * own[-1] * shared + np.square(own[-1]) * taken, 0.0)
        return taken / along.shape[1]


class TaskVariance(TaskGain):
    """What measurements take from a model's mean variance over a task, in standard units squared."""

    def _begin(self, across: Array) -> Gains:
        return VarianceTaken(across)

    def score(self, trajectories: Array, count: int) -> Array:
        """Return what the best `count` rows of each of (R, T, D) trajectories take, (R,), many trajectories at once.

        The covariances c among samples and their products p over the task, (R, T, T), are conditioned on each pick.
        """
        check_count(count, trajectories.shape[1])
        size = max(1, LARGEST_BLOCK // (trajectories.shape[1] * len(self._task)))
        blocks = range(0, len(trajectories), size)
        return np.concatenate([self._score(trajectories[start : start + size], count) for start in blocks])

    def _score(self, trajectories: Array, count: int) -> Array:
        c, across = self._condition(trajectories)
        return _take_best(c, across @ across.swapaxes(1, 2) / across.shape[2], self._noise, count)

    def _add(self, taken: Array) -> Array:
        return taken.mean(axis=1)


@njit(cache=True, error_model="numpy")
def _take_best(c: Array, p: Array, noise: float, count: int) -> Array:
    """Condition c and p, (R, T, T), on `count` picks of each trajectory; return what these took, (R,)."""
    trajectories, samples = c.shape[:2]
    total = np.zeros(trajectories)
    for r in range(trajectories):
        own, shared, left = c[r], p[r], np.ones(samples, dtype=np.bool_)
        for _ in range(count):
            best, most = -1, -np.inf
            for t in range(samples):
                gain = max(shared[t, t], 0.0) / (max(own[t, t], 0.0) + noise)
                if left[t] and gain > most:
                    best, most = t, gain
            left[best] = False
            total[r] += most
            weights = own[best] / (max(own[best, best], 0.0) + noise)
            half = shared[best] - 0.5 * shared[best, best] * weights
            taken = own[best].copy()
            for t in range(samples):
                for u in range(samples):
                    own[t, u] -= weights[t] * taken[u]
                    shared[t, u] -= weights[t] * half[u] + half[t] * weights[u]
    return total
