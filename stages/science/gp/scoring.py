"""The utility of every trajectory of a bank: point utilities added over muscles and samples, or joint information."""

from collections.abc import Sequence

import numpy as np

from stages.science.gp.kernel import Array
from stages.science.gp.marginal import MarginalGP
from stages.science.gp.marginal_model import MarginalModel
from stages.science.gp.utilities import UTILITIES
from stages.science.gp.utility_names import find_utility

JOINT = "log_det"
REDUCTIONS = ("sum", "max")
MEMORY_SHARE = 0.25
"""Of the memory, for the scores of one muscle; the size of a chunk, and so the last bit of a result, depends on it."""


def trajectory_utility(
    models: Sequence[MarginalModel],
    candidates: Sequence[Array],
    utility: str,
    reduce: str = "sum",
    memory_mb: float = 64.0,
    stride: int = 10,
) -> Array:
    """Score every trajectory of a bank.

    Parameters
    ----------
    models, candidates : sequences over M muscles of MarginalModel and of (R, T, D) float arrays
        Exact or sparse, ``log_det`` takes exact ones; standardised inputs along each trajectory.
    utility : str
        A point utility, added up over muscles and samples, or ``log_det``, the joint information of a trajectory.
    reduce : str
        ``sum`` or ``max`` over the samples of a trajectory; has no meaning for ``log_det``.
    memory_mb : float
        Bound on the working memory beyond the output (MB).
    stride : int
        ``log_det`` takes every so-many-th sample.

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
    if stride < 1:
        raise ValueError(f"stride: expected at least 1, got {stride}")
    if not memory_mb > 0:
        raise ValueError(f"memory_mb: expected more than 0, got {memory_mb}")
    shapes = [np.shape(each) for each in candidates]
    if not models or len(models) != len(shapes) or any(len(each) != 3 or each[:2] != shapes[0][:2] for each in shapes):
        raise ValueError(f"expected candidates (R, T, D) for each of {len(models)} models, got {len(shapes)}: {shapes}")
    if utility != JOINT:
        find_utility(utility, also=(JOINT,))

    scores = []
    for model, inputs in zip(models, candidates, strict=True):
        trajectories, samples, dimensions = inputs.shape
        if utility != JOINT:
            points = model.utility(inputs.reshape(-1, dimensions), utility, memory_mb * MEMORY_SHARE)
            scores.append(getattr(points.reshape(trajectories, samples), reduce)(axis=1))
        elif isinstance(model, MarginalGP):
            scores.append([model.joint_information(trajectory[::stride]) for trajectory in inputs])
        else:
            raise ValueError(
                f"utility: {JOINT} takes exact models, got a {type(model).__name__}, which scores points one by one; "
                f"use one of {', '.join(UTILITIES)}"
            )
    return np.asarray(np.sum(scores, axis=0))
