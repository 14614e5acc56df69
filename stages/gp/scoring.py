"""The utility of every trajectory of a bank: point utilities added over muscles and samples, or joint information."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from stages.gp.marginal import MarginalGP
from stages.gp.utilities import TRAJECTORY_UTILITY, find_utility

Array = NDArray[np.float64]

REDUCTIONS = ("sum", "max")


def trajectory_utility(
    models: Sequence[MarginalGP],
    candidates: Sequence[Array],
    utility: str,
    reduce: str = "sum",
    memory_mb: float = 64.0,
    stride: int = 10,
    threads: int = 1,
) -> Array:
    """Score every trajectory of a bank.

    Parameters
    ----------
    models : sequence over M muscles of MarginalGP
        One for each muscle.
    candidates : sequence over M muscles of (R, T, D) float arrays
        Inputs along each trajectory, standardised.
    utility : str
        A point utility, added up over muscles and samples, or ``log_det``, the joint information of a trajectory.
    reduce : str
        ``sum`` or ``max`` over the samples of a trajectory; has no meaning for ``log_det``.
    memory_mb : float
        Bound on the working memory beyond the output, over all threads (MB).
    stride : int
        ``log_det`` takes every so-many-th sample.
    threads : int
        Muscles scored at a time; the result does not depend on it.

    Returns
    -------
    (R,) float array
        Nats for the information utilities.

    Raises
    ------
    ValueError
        When a name is unknown or shapes do not fit.
    """
    if reduce not in REDUCTIONS:
        raise ValueError(f"reduce: expected one of {', '.join(REDUCTIONS)}, got {reduce!r}")
    shapes = {np.shape(each)[:2] for each in candidates}
    if len(models) != len(candidates) or len(shapes) != 1 or not len(models):
        raise ValueError(
            f"expected candidates (R, T, D) for each of {len(models)} models, got {len(candidates)}: {shapes}"
        )
    if utility != TRAJECTORY_UTILITY:
        find_utility(utility)

    def score(model: MarginalGP, inputs: Array) -> Array:
        if utility == TRAJECTORY_UTILITY:
            return np.array([model.joint_information(trajectory[::stride]) for trajectory in inputs])
        trajectories, samples, dimensions = inputs.shape
        bounded = model.with_memory(memory_mb / threads)
        points = bounded.utility(inputs.reshape(-1, dimensions), utility)
        along = points.reshape(trajectories, samples)
        return along.sum(axis=1) if reduce == "sum" else along.max(axis=1)

    if threads == 1:
        scores = [score(model, inputs) for model, inputs in zip(models, candidates, strict=True)]
    else:
        with ThreadPoolExecutor(threads) as pool:
            scores = list(pool.map(score, models, candidates))
    total: Array = np.sum(scores, axis=0)
    return total
