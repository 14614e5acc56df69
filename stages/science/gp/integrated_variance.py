"""What noisy measurements take from a model's mean posterior variance over the inputs that it is wanted for, its task.

A model, (Q, D) inputs of the task and the inputs of trajectories flow in; picks and gains flow out. With c the
posterior covariance given the data, a measurement at x takes

    1/Q sum_q c(z_q, x)^2 / (c(x, x) + sn^2)

from the mean of c(z_q, z_q). Samples are picked greedily, each time given those before: the I-optimal design of Seo,
Wallat, Graepel and Obermayer, Gaussian process regression: active data selection (IJCNN 2000). Hyperparameters are
held; neither data nor outputs are needed but for the model's.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack
from scipy.spatial.distance import cdist

from stages.science.gp.kernel import Array
from stages.science.gp.marginal import MarginalGP
from stages.science.gp.posterior import check_points
from stages.science.gp.subsample import Displace, check_count

INTEGRATED_VARIANCE = "integrated_variance"


class TaskVariance:
    """What measurements take from a model's mean variance over a task, in standard units squared."""

    def __init__(self, model: MarginalGP, task: Array):
        self._lengths = model.hyperparameters.lengths
        self._signal, self._noise = model.hyperparameters.signal_variance, model.noise_variance
        self._whiten = model.whiten
        self._task = check_points(task, self._lengths.size, "task")
        if not len(self._task):
            raise ValueError("task: expected at least one input, got none")
        self._whitened_task = self._whiten(self._task)

    def pick(self, inputs: Array, count: int, displace: Displace | None = None) -> tuple[NDArray[np.intp], float]:
        """Return the rows of (T, D) inputs that take most, (count,), in the order of picking, and what they take.

        `displace` may take another row in place of each pick, as in `subsample`.
        """
        inputs = check_points(inputs, self._lengths.size)
        check_count(count, len(inputs))
        return self._pick(inputs, self._whiten(inputs), count, displace)

    def score(self, trajectories: Array, count: int) -> Array:
        """Return what the best `count` rows of each of (R, T, D) trajectories take, (R,)."""
        whitened = self._whiten(trajectories.reshape(-1, trajectories.shape[-1])).reshape(-1, *trajectories.shape[:2])
        return np.array([self._pick(each, whitened[:, r], count)[1] for r, each in enumerate(trajectories)])

    def take(self, trajectories: Array) -> Array:
        """Return what all samples of each of (R, T, D) trajectories take together, (R,)."""
        count, samples, inputs = trajectories.shape
        check_count(1, samples)
        points = check_points(trajectories.reshape(-1, inputs), self._lengths.size)
        whitened = self._whiten(points)
        across = self._covary(points / self._lengths, self._task / self._lengths) - whitened.T @ self._whitened_task
        across = across.reshape(count, samples, -1)
        whitened = whitened.T.reshape(count, samples, -1)
        scaled = (points / self._lengths).reshape(count, samples, -1)
        squares = np.square(scaled[:, :, None] - scaled[:, None]).sum(axis=-1)
        among = self._signal * np.exp(-0.5 * squares) - whitened @ whitened.swapaxes(1, 2)
        among[:, np.arange(samples), np.arange(samples)] += self._noise
        lower = np.linalg.cholesky(among)
        solved = (lapack.dtrtrs(its, each, lower=1)[0] for its, each in zip(lower, across, strict=True))
        return np.array([np.square(each).sum() for each in solved]) / len(self._task)

    def _covary(self, one: Array, other: Array) -> Array:
        """Return the prior covariance of inputs in units of the lengths."""
        return np.asarray(self._signal * np.exp(-0.5 * cdist(one, other, "sqeuclidean")))

    def _pick(
        self, inputs: Array, whitened: Array, count: int, displace: Displace | None = None
    ) -> tuple[NDArray[np.intp], float]:
        scaled = inputs / self._lengths
        across = self._covary(scaled, self._task / self._lengths) - whitened.T @ self._whitened_task
        variance = np.maximum(self._signal - np.square(whitened).sum(axis=0), 0.0)
        norms = np.einsum("tq,tq->t", across, across)
        picks: list[int] = []
        own, along = np.empty((count, len(inputs))), np.empty((count, len(self._task)))
        taken = 0.0
        for k in range(count):  # `across` stays as it is: earlier picks took own[:k]' along[:k] from it
            gains = norms / (len(self._task) * (variance + self._noise))
            gains[picks] = -np.inf
            best = int(np.argmax(gains))
            if displace is not None:
                best = displace(best, picks)
            before, scale = own[:k, best].copy(), np.sqrt(variance[best] + self._noise)
            squares = np.square(scaled - scaled[best]).sum(axis=1)
            column = self._signal * np.exp(-0.5 * squares) - whitened[:, best] @ whitened
            own[k] = (column - before @ own[:k]) / scale
            along[k] = (across[best] - before @ along[:k]) / scale
            shared = across @ along[k] - (along[:k] @ along[k]) @ own[:k]
            norms = np.maximum(norms - 2.0 * own[k] * shared + np.square(own[k]) * (along[k] @ along[k]), 0.0)
            variance = np.maximum(variance - np.square(own[k]), 0.0)
            picks.append(best)
            taken += float(along[k] @ along[k]) / len(self._task)
        return np.array(picks, dtype=np.intp), taken


def reduce_task_variance(
    models: Sequence[MarginalGP], tasks: Sequence[Array], candidates: Sequence[Array], count: int
) -> Array:
    """Return what the best `count` samples of every trajectory take from the tasks' mean variances, (R,).

    Parameters
    ----------
    models, tasks, candidates : sequences over M muscles of MarginalGP, (Q, D) and (R, T, D) float arrays
        Standardised inputs that the models are wanted for, and those along each trajectory.
    count : int
        Samples that a trial gives each model.

    Returns
    -------
    (R,) float array
        Added over muscles, each in the square of its standard unit.

    Raises
    ------
    ValueError
        When shapes do not fit or a task is empty.
    """
    scores = []
    for model, task, inputs in zip(models, tasks, candidates, strict=True):
        scores.append(TaskVariance(model, task).score(inputs, count))
    total: Array = np.sum(scores, axis=0)
    return total
