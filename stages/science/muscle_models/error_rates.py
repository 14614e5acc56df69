"""Error rates of models: on recordings whose force no model has seen the whole of, over muscles, over experiments.

Rows of a bank flow in, or of a table of error rates; error rates flow out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from stages.science.gp.marginal import MarginalGP
from stages.science.muscle_models.muscle_set import MuscleSet
from stages.science.signals.measures import error_rate
from stages.science.signals.scaling import MODEL_OUTPUT, Array, Scaling

ALL_MUSCLES = "mean"
"""What tables call the average over muscles."""
TEST_WORDS = {"task": "the task", "bank": "the bank", "unseen_bank": "movements that nothing else saw"}
"""Test sets in words."""
ENDED = " Experiments that ended before keep their last error."
"""What captions say where errors were carried forward."""


def carry_forward(errors: pd.DataFrame) -> pd.DataFrame:
    """Return the error rates with those of the last trial for all later ones, where experiments ended before others.

    A frame whose experiments have all trials comes back as it is.
    """
    keys = [name for name in errors.columns if name not in ("trial", "rmse_n", "error_rate")]
    wide = errors.pivot(index=keys, columns="trial", values="error_rate")
    if not wide.isna().any(axis=None):
        return errors
    return wide.ffill(axis=1).melt(value_name="error_rate", ignore_index=False).reset_index()


def average_muscles(errors: pd.DataFrame, values: Sequence[str] = ("error_rate",)) -> pd.DataFrame:
    """Return the values averaged over muscles, with all other columns but rmse_n."""
    keys = [name for name in errors.columns if name not in ("muscle", "rmse_n", *values)]
    return errors.groupby(keys, sort=False)[list(values)].mean().reset_index().assign(muscle=ALL_MUSCLES)


def add_average(errors: pd.DataFrame) -> pd.DataFrame:
    """Return the error rates with rows of the average over muscles."""
    average = average_muscles(errors)
    return pd.concat([errors[average.columns], average], ignore_index=True)


def summarise_error_rates(errors: pd.DataFrame, by: Sequence[str]) -> pd.DataFrame:
    """Return mean and standard deviation over experiments, as error_rate_mean and error_rate_sd."""
    told = errors.groupby(list(by), sort=False)["error_rate"].agg(["mean", "std"]).reset_index()
    return told.rename(columns={"mean": "error_rate_mean", "std": "error_rate_sd"})


@dataclass(frozen=True)
class ForceTest:
    """Standardised inputs (N, D) and measured forces (N,) of every muscle, and the table that they come from."""

    name: str
    scalings: list[Scaling]
    inputs: tuple[Array, ...]
    forces_n: tuple[Array, ...]

    @classmethod
    def read(cls, name: str, recordings: pd.DataFrame, muscles: MuscleSet) -> ForceTest:
        """Gather recordings by muscle."""
        forces_n = (recordings.loc[recordings["muscle"] == each, MODEL_OUTPUT].to_numpy() for each in muscles.names)
        return cls(name, muscles.scalings, tuple(muscles.inputs_of(recordings)), tuple(forces_n))

    @property
    def largest_n(self) -> list[float]:
        """Largest force of each muscle, N, by which error rates are divided."""
        return [float(each.max()) for each in self.forces_n]

    def error_rates(self, models: Sequence[MarginalGP]) -> list[float]:
        """Return the RMSE of each muscle's model over the muscle's largest force."""
        return [
            error_rate(scaling.restore_force(model.predict_mean(inputs)), force)
            for model, scaling, inputs, force in zip(models, self.scalings, self.inputs, self.forces_n, strict=True)
        ]
