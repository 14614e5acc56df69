"""The utility of every trajectory of a bank: point utilities added over muscles and samples, or joint information."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Protocol, runtime_checkable

import numpy as np

from stages.science.gp.kernel import Array
from stages.science.gp.utilities import TRAJECTORY_UTILITY, UTILITIES, find_utility

REDUCTIONS = ("sum", "max")
MOST_THREADS = 4
"""Share the memory, however many run: the size of a chunk, and so the last bit of a result, does not depend on them."""


class PointScorer(Protocol):
    """A model that scores points one by one."""

    def utility(self, points: Array, name: str, memory_mb: float = ...) -> Array:
        """Return a point utility of (B, D) points, (B,), within so much working memory (MB)."""


@runtime_checkable
class JointScorer(Protocol):
    """A model that scores points together."""

    def joint_information(self, points: Array) -> float:
        """Return what measurements at all (T, D) points together tell about theta (nats)."""


def trajectory_utility(
    models: Sequence[PointScorer],
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
    models : sequence over M muscles of PointScorer
        One for each muscle, exact or sparse; ``log_det`` takes exact ones.
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
        Muscles scored at a time, at most `MOST_THREADS`; the result does not depend on it.

    Returns
    -------
    (R,) float array
        Nats for the information utilities.

    Raises
    ------
    ValueError
        When a name is unknown, shapes do not fit or a model has no joint information.
    """
    if reduce not in REDUCTIONS:
        raise ValueError(f"reduce: expected one of {', '.join(REDUCTIONS)}, got {reduce!r}")
    for name, value in (("stride", stride), ("threads", threads)):
        if value < 1:
            raise ValueError(f"{name}: expected at least 1, got {value}")
    if not memory_mb > 0:
        raise ValueError(f"memory_mb: expected more than 0, got {memory_mb}")
    shapes = [np.shape(each) for each in candidates]
    if not models or len(models) != len(shapes) or any(len(each) != 3 or each[:2] != shapes[0][:2] for each in shapes):
        raise ValueError(f"expected candidates (R, T, D) for each of {len(models)} models, got {len(shapes)}: {shapes}")
    if utility != TRAJECTORY_UTILITY:
        find_utility(utility, also=(TRAJECTORY_UTILITY,))

    def score(model: PointScorer, inputs: Array) -> Array:
        if utility == TRAJECTORY_UTILITY:
            if not isinstance(model, JointScorer):
                raise ValueError(
                    f"utility: {TRAJECTORY_UTILITY} takes exact models, got a {type(model).__name__}, which scores "
                    f"points one by one; use one of {', '.join(UTILITIES)}"
                )
            return np.array([model.joint_information(trajectory[::stride]) for trajectory in inputs])
        trajectories, samples, dimensions = inputs.shape
        points = model.utility(inputs.reshape(-1, dimensions), utility, memory_mb / MOST_THREADS)
        along = points.reshape(trajectories, samples)
        return along.sum(axis=1) if reduce == "sum" else along.max(axis=1)

    if threads == 1:
        scores = [score(model, inputs) for model, inputs in zip(models, candidates, strict=True)]
    else:
        with ThreadPoolExecutor(min(threads, MOST_THREADS)) as pool:
            scores = list(pool.map(score, models, candidates))
    total: Array = np.sum(scores, axis=0)
    return total
