"""What noisy measurements take from a model's mean posterior variance over the inputs that it is wanted for, its task.

With c the posterior covariance given the data, a measurement at x takes

    1/Q sum_q c(z_q, x)^2 / (c(x, x) + sn^2)

from the mean of c(z_q, z_q): the I-optimal design of Seo, Wallat, Graepel and Obermayer, Gaussian process regression:
active data selection (IJCNN 2000), in the square of standard units.
"""

import numpy as np

from stages.science.gp.kernel import Array
from stages.science.gp.task_gain import Gains, TaskGain

INTEGRATED_VARIANCE = "integrated_variance"


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

    def _add(self, taken: Array) -> Array:
        return taken.mean(axis=1)
