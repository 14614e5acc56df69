"""A whole session with its description, as the tables that the discrepancy workflow reads.

Samples and what meta.json would hold flow in; `MeasuredTables` flow out.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from stages.science.recording.measured_tables import MeasuredTables
from stages.science.recording.muscles import read_session


def tabulate_session(samples: pd.DataFrame, meta: Mapping[str, Any], source: str) -> MeasuredTables:
    """Return a session's tables; that of signals is empty.

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
    measured = measured.drop(columns="place").reset_index(drop=True)
    return MeasuredTables(measured, pd.DataFrame(columns=["signal"]), trials, muscles, session)
