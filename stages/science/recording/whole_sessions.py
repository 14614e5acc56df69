"""A whole session with its description, as the tables that the discrepancy workflow reads.

Samples and what meta.json would hold flow in; frames of samples, trials, muscles and session flow out.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import pandas as pd

from stages.science.recording.muscles import read_session


class SessionFrames(NamedTuple):
    """Samples by trial, muscle and time; a row for each trial and each muscle; one row for the session."""

    measured: pd.DataFrame
    trials: pd.DataFrame
    muscles: pd.DataFrame
    session: pd.DataFrame


def tabulate_session(samples: pd.DataFrame, meta: Mapping[str, Any], source: str) -> SessionFrames:
    """Return a session's frames.

    Parameters
    ----------
    samples : DataFrame
        A row per trial, time and muscle, without gaps in time.
    meta : mapping
        What meta.json holds.
    source : str
        Name of the session.

    Raises
    ------
    RecordingError
        When meta lacks something.
    """
    told = read_session(meta)
    muscles = told.describe()
    place = samples["muscle"].map({name: index for index, name in enumerate(muscles["muscle"])})
    measured = samples.assign(place=place).sort_values(["trial", "place", "time_s"], kind="stable")
    count = samples.groupby("trial")["time_s"].nunique()
    trials = pd.DataFrame({"trial": count.index, "part": "", "record": "", "samples": count.to_numpy()})
    trials = trials.assign(start_s=told.starts_of([int(each) for each in count.index]))
    trials = trials.assign(duration_s=trials["samples"] / told.sampling_rate_hz)
    session = pd.DataFrame(
        {
            "source": [source],
            "kind": ["muscles"],
            "sampling_rate_hz": [told.sampling_rate_hz],
            "load_cell_site": [told.load_cell_site],
            "timing": [told.timing],
            "trials": [len(trials)],
            "muscles": [len(muscles)],
        }
    )
    return SessionFrames(measured.drop(columns="place").reset_index(drop=True), trials, muscles, session)
