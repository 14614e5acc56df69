"""The utilities that serve a task, by name, and the scores of a bank by one of them."""

from collections.abc import Mapping, Sequence

import numpy as np

from stages.science.gp.integrated_variance import INTEGRATED_VARIANCE, TaskVariance
from stages.science.gp.kernel import Array
from stages.science.gp.marginal import MarginalGP
from stages.science.gp.predictive_information import PREDICTIVE_INFORMATION, TaskInformation
from stages.science.gp.task_gain import TaskGain
from stages.science.gp.utilities import UTILITIES

TASK_UTILITIES: Mapping[str, type[TaskGain]] = {
    INTEGRATED_VARIANCE: TaskVariance,
    PREDICTIVE_INFORMATION: TaskInformation,
}


def tell_unit(name: str) -> str:
    """Return the unit of a utility's scores, by its name; empty for a function of one's own, whose unit is unknown."""
    if name in ("variance", INTEGRATED_VARIANCE):
        return "standard units²"
    return "nat" if name in (*UTILITIES, PREDICTIVE_INFORMATION, "log_det") else ""


def task_utility(
    models: Sequence[MarginalGP], tasks: Sequence[Array], candidates: Sequence[Array], count: int, utility: str
) -> Array:
    """Return what the best `count` samples of every trajectory gain for the tasks, (R,), by one of `TASK_UTILITIES`.

    Of each of M muscles a model, the standardised inputs that it is wanted for, (Q, D), and those along each
    trajectory, (R, T, D); a trial gives each model so many samples. Gains are added over muscles, each in the square of
    its standard unit or in nats. A `ValueError` tells shapes that do not fit and an empty task.
    """
    gain = TASK_UTILITIES[utility]
    scores = [
        gain(model, task).score(inputs, count) for model, task, inputs in zip(models, tasks, candidates, strict=True)
    ]
    return np.asarray(np.sum(scores, axis=0))
