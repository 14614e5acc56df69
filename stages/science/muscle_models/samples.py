"""The samples that models stand on, taken from what was executed."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from stages.science.muscle_models.inputs import FEATURE_COLUMNS, ModelSettings
from stages.science.signals.lead_in import leave_out_lead_in
from stages.science.signals.scaling import MODEL_INPUTS, MODEL_OUTPUT

TAKEN = ["muscle", "pick", "time_s", *MODEL_INPUTS, MODEL_OUTPUT, *FEATURE_COLUMNS]
"""Columns of samples that are taken, the features of the past where the samples have them."""


def place_evenly(count: int, samples: int) -> NDArray[np.intp]:
    """Return the (count,) rows that are evenly spread over so many samples."""
    return ((np.arange(count) + 0.5) * samples / count).astype(np.intp)


def spread_evenly(executed: pd.DataFrame, count: int, muscles: Sequence[str]) -> pd.DataFrame:
    """Return `count` samples of each muscle, evenly spread over the executed trials."""
    return take(executed, [place_evenly(count, (executed["muscle"] == name).sum()) for name in muscles], muscles)


def keep_usable(executed: pd.DataFrame) -> pd.DataFrame:
    """Return the samples of trials, not of their lead-ins, that are as measured: of those, models are made."""
    return executed[(executed["status"] == "ok") & (executed["time_s"] >= 0.0)]


def take(samples: pd.DataFrame, picks: Sequence[NDArray[np.intp]], muscles: Sequence[str]) -> pd.DataFrame:
    """Return the picked samples of each muscle, in the order of picking."""
    columns = [name for name in TAKEN if name == "pick" or name in samples]
    measured = samples[[name for name in columns if name != "pick"]]
    frames = [
        measured[measured["muscle"] == name].iloc[at].assign(pick=range(len(at)))
        for name, at in zip(muscles, picks, strict=True)
    ]
    return pd.concat(frames, ignore_index=True)[columns]


def list_tests(given: Mapping[str, pd.DataFrame | None]) -> dict[str, pd.DataFrame]:
    """Return the test sets that there are, without lead-ins."""
    return {name: leave_out_lead_in(each) for name, each in given.items() if each is not None}


def gather_tests(model: ModelSettings, given: Mapping[str, pd.DataFrame | None]) -> dict[str, pd.DataFrame]:
    """Return the test sets that there are, with the features of a model's past, which lead-ins are part of."""
    return {name: model.extend(each, ["trajectory"]) for name, each in given.items() if each is not None and len(each)}


def keep_wanted(samples: pd.DataFrame) -> pd.DataFrame:
    """Return the samples of trials, not of their lead-ins, that the task wants, where they say so."""
    samples = leave_out_lead_in(samples)
    return samples[samples["wanted"]] if "wanted" in samples else samples


def locate_points(
    points: pd.DataFrame, initial: pd.DataFrame, designed: pd.DataFrame, values: Mapping[str, NDArray[Any]]
) -> pd.DataFrame:
    """Return the points of one arm with more columns: `values` at the samples of the executed trials that they are.

    `points`, `initial` and `designed` are rows of `points`, `hardware_recordings` and `active_recordings`; the values
    are (N,) arrays by column, for each of the N rows that `join_executed` makes of the recordings. A `ValueError` tells
    a point that is no sample of these trials. Points of the initial data do not tell their trial: they are found by
    what was measured.
    """
    own = designed[designed["arm"] == points["arm"].iloc[0]]
    trials = pd.concat([initial.assign(trial=0), own], ignore_index=True)
    keys = ["participant", "experiment", "trial", "muscle", "time_s", *MODEL_INPUTS, MODEL_OUTPUT]
    rows = trials[keys].assign(**values).drop_duplicates(keys)
    found = points.merge(rows, how="left", on=keys, validate="many_to_one")
    if found[list(values)].isna().any(axis=None):
        raise ValueError("points: expected samples of the executed trials, got others; run stages=[active_loop] again")
    return found


def thin(executed: pd.DataFrame, every: int, trial: Sequence[str]) -> pd.DataFrame:
    """Return the first of every so many usable samples of each muscle in each trial, named by so many columns."""
    executed = keep_usable(executed)
    rank = executed.groupby([*trial, "muscle"], sort=False).cumcount()
    return executed[rank % every == 0]
