"""What noisy measurements tell of noisy measurements at the inputs that a model is wanted for, its task.

With c the posterior covariance given the data, a measurement at x tells of those at the task, one by one,

    1/Q sum_q I(y(x); y(z_q)) = 1/Q sum_q 1/2 log((c(z_q, z_q) + sn^2) / (c(z_q, z_q | x) + sn^2))

nats: the expected predictive information gain of Bickford Smith, Kirsch, Farquhar, Gal, Foster and Rainforth,
Prediction-oriented Bayesian active learning (AISTATS 2023). Halving a small variance counts as much as halving a large
one, which the mean variance does not see.
"""

import numpy as np

from stages.science.gp.kernel import Array
from stages.science.gp.task_gain import Gains, TaskGain

PREDICTIVE_INFORMATION = "predictive_information"


class InformationGained(Gains):
    """By the (T, Q) covariance with the task and the task's (Q,) variances with noise, given the picks so far."""

    def __init__(self, across: Array, noisy_task: Array, noise: float):
        self._across, self._task, self._noise = across.copy(), noisy_task, noise

    def of(self, noisy: Array) -> Array:
        """Return the mean information of a measurement at each row, (T,)."""
        return tell(np.square(self._across) / noisy[:, None], self._task, self._noise)

    def take(self, own: Array, along: Array) -> float:
        """Condition on one more pick and return what it told."""
        taken = np.square(along[-1])
        told = float(tell(taken[None], self._task, self._noise)[0])
        self._across -= np.outer(own[-1], along[-1])
        self._task = np.maximum(self._task - taken, self._noise)
        return told


class TaskInformation(TaskGain):
    """What measurements tell of measurements at a task, in nats."""

    def _begin(self, across: Array) -> Gains:
        return InformationGained(across, self._variance(self._whitened_task) + self._noise, self._noise)

    def _add(self, taken: Array) -> Array:
        return tell(taken, self._variance(self._whitened_task) + self._noise, self._noise)


def tell(taken: Array, noisy_task: Array, noise: float) -> Array:
    """Return the mean information, (T,), of taking (T, Q) variances from the task's (Q,) ones with noise."""
    return 0.5 * np.log1p(taken / np.maximum(noisy_task - taken, noise)).mean(axis=1)
