"""Error rates of models, a row for each muscle: their average over muscles, and their mean over experiments."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

ALL_MUSCLES = "mean"
"""What tables call the average over muscles."""


def average_muscles(errors: pd.DataFrame, values: Sequence[str] = ("error_rate",)) -> pd.DataFrame:
    """Return the values averaged over muscles, with all other columns but rmse_n."""
    keys = [name for name in errors.columns if name not in ("muscle", "rmse_n", *values)]
    averaged = errors.groupby(keys, sort=False)[list(values)].mean().reset_index()
    return averaged.assign(muscle=ALL_MUSCLES)


def add_average(errors: pd.DataFrame) -> pd.DataFrame:
    """Return the error rates with rows of the average over muscles."""
    average = average_muscles(errors)
    return pd.concat([errors[average.columns], average], ignore_index=True)


def summarise_error_rates(errors: pd.DataFrame, by: Sequence[str]) -> pd.DataFrame:
    """Return mean and standard deviation over experiments, as error_rate_mean and error_rate_sd."""
    told = errors.groupby(list(by), sort=False)["error_rate"].agg(["mean", "std"]).reset_index()
    return told.rename(columns={"mean": "error_rate_mean", "std": "error_rate_sd"})
