"""What was chosen and what was identified, as rows of tables.

A `Choice` and models flow in; plain values and frames in the columns of the tables flow out.
"""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from stages.science.gp.knowledge import Choice, Knowledge
from stages.science.gp.marginal_model import MarginalModel
from stages.science.muscle_models.muscle_set import MuscleSet


def describe_choice(choice: Choice, known: Knowledge, muscles: MuscleSet) -> dict[str, int | float]:
    """Return trajectory, its utility, that of the runner-up, and how many were available."""
    best = runner_up = np.nan
    if choice.scores is not None:
        ranked = np.sort(choice.scores[np.isfinite(choice.scores)])[::-1]
        best, runner_up = ranked[0], ranked[1] if ranked.size > 1 else np.nan
    return {
        "trajectory": muscles.trajectories[choice.trajectory],
        "utility": float(best),
        "runner_up": float(runner_up),
        "available": known.available.size,
    }


def describe_models(models: Sequence[MarginalModel], muscles: MuscleSet) -> pd.DataFrame:
    """Return one row for each muscle and hyperparameter: value, SD by the Laplace approximation, density, repair."""
    frames = [
        pd.DataFrame(
            {
                "muscle": name,
                "hyperparameter": muscles.hyperparameters,
                "value": model.theta,
                "sd": np.sqrt(np.diag(model.laplace.covariance)),
                "log_posterior": model.log_posterior,
                "repair": model.repair,
            }
        )
        for name, model in zip(muscles.names, models, strict=True)
    ]
    return pd.concat(frames, ignore_index=True)
