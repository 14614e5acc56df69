"""The samples that models stand on, taken from what was executed."""

from collections.abc import Mapping, Sequence

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


def thin(executed: pd.DataFrame, every: int, trial: Sequence[str]) -> pd.DataFrame:
    """Return the first of every so many usable samples of each muscle in each trial, named by so many columns."""
    executed = keep_usable(executed)
    rank = executed.groupby([*trial, "muscle"], sort=False).cumcount()
    return executed[rank % every == 0]
